"""scipy.optimize.least_squares on measured robots: 24 link parameters + base + targets, from nominal.

    cargo run --release --example study identification splits DIR     # writes one CSV per set and seed
    python docs/oracles/scipy_least_squares.py DIR > docs/oracles/scipy_least_squares.csv

A second implementation on the same splits: numerical derivatives, scipy's trust region, nothing shared with our code.
"""
import csv
import json
import pathlib
import sys

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation


def load(path):
    rows = list(csv.DictReader(open(path)))
    n = sum(1 for key in rows[0] if key.startswith("q"))
    q = np.array([[float(r[f"q{i + 1}_rad"]) for i in range(n)] for r in rows])
    p = np.array([[float(r[f"{axis}_mm"]) for axis in "xyz"] for r in rows])
    target = np.array([int(r["target"]) for r in rows])
    return q, p, target, np.array([r["subset"] == "identify" for r in rows])


def flange(links, q):
    """Rx(alpha) Dx(a) Rz(q + theta) Dz(d) of every pose: rotations and positions, mm."""
    rotation, position = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    for i, (a, alpha, d, theta) in enumerate(links):
        ca, sa, c, s = np.cos(alpha), np.sin(alpha), np.cos(q[:, i] + theta), np.sin(q[:, i] + theta)
        zero = np.zeros_like(c)
        step = np.stack([np.stack([c, -s, zero], 1), np.stack([ca * s, ca * c, zero - sa], 1), np.stack([sa * s, sa * c, zero + ca], 1)], 1)
        position = position + np.einsum("nij,j->ni", rotation, np.array([a, -sa * d, ca * d]))
        rotation = rotation @ step
    return rotation, position


def predicted(x, n_links, n_targets, q, target):
    links = x[: 4 * n_links].reshape(n_links, 4)
    base = x[4 * n_links : 4 * n_links + 6]
    offsets = x[4 * n_links + 6 :].reshape(n_targets, 3)
    rotation, position = flange(links, q)
    p = position + np.einsum("nij,nj->ni", rotation, offsets[target])
    return Rotation.from_rotvec(base[3:]).apply(p) + base[:3]


def placed(nominal, q, p, target, n_targets):
    """Base and targets with nominal links, best of 24 starting rotations."""
    links, best = nominal.ravel(), None
    for turn in Rotation.create_group("O"):
        base = np.concatenate([p.mean(0) - turn.apply(flange(nominal, q)[1].mean(0)), turn.as_rotvec()])
        f = lambda y: (p - predicted(np.concatenate([links, y]), len(nominal), n_targets, q, target)).ravel()
        fit = least_squares(f, np.concatenate([base, np.zeros(3 * n_targets)]), x_scale="jac")
        if best is None or fit.cost < best.cost:
            best = fit
    return best.x


def main(folder):
    print("set,seed,verify_rms_mm")
    for path in sorted(folder.glob("*.csv")):
        name, seed = path.stem.rsplit("-", 1)
        links = json.loads((folder / f"{name}.json").read_text())["links"]
        nominal = np.array([[v["a_mm"], np.radians(v["alpha_deg"]), v["d_mm"], np.radians(v["theta_offset_deg"])] for v in links])
        q, p, target, identify = load(path)
        n_targets = target.max() + 1
        start = np.concatenate([nominal.ravel(), placed(nominal, q[identify], p[identify], target[identify], n_targets)])
        f = lambda x: (p[identify] - predicted(x, len(nominal), n_targets, q[identify], target[identify])).ravel()
        fit = least_squares(f, start, x_scale="jac")
        error = p[~identify] - predicted(fit.x, len(nominal), n_targets, q[~identify], target[~identify])
        print(f"{name},{seed},{np.sqrt((error**2).sum(1).mean()):.6f}", flush=True)


main(pathlib.Path(sys.argv[1]))
