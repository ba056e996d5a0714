"""scipy.optimize.least_squares on several sessions of one robot at once: one set of links, each session with its own base and targets.

    python docs/oracles/sessions.py ROBOT.json FIRST.csv SECOND.csv ... [--alone]

The rows of `subset` identify are fitted, those of verify are scored; prints the verify rms of all sessions together and of each, mm. --alone fits each
session by itself instead. A second implementation: numerical derivatives, scipy's trust region, no priors, nothing shared with kincal's code. Free are
a, alpha, d and theta of every link, and beta where neighbouring axes are nominally nearly parallel. Links and placement start from nominal.
"""
import csv
import json
import sys

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

NEARLY_PARALLEL = 0.2  # |sin alpha| below which beta is free


def read(path):
    rows = list(csv.DictReader(open(path)))
    n = sum(1 for key in rows[0] if key.startswith("q") and key.endswith(("_rad", "_deg")))
    value = lambda row, i: float(row[f"q{i}_rad"]) if f"q{i}_rad" in row else np.radians(float(row[f"q{i}_deg"]))
    return dict(
        q=np.array([[value(row, i + 1) for i in range(n)] for row in rows]),
        p=np.array([[float(row[f"{axis}_mm"]) for axis in "xyz"] for row in rows]),
        target=np.array([int(row.get("target") or 0) for row in rows]),
        fitted=np.array([row["subset"] == "identify" for row in rows]),
    )


def rotation(axis, angle):
    return Rotation.from_rotvec(np.outer(np.atleast_1d(angle), axis)).as_matrix()


def flange(links, q):
    """Rx(alpha) Dx(a) Ry(beta) Rz(q + theta) Dz(d) of every pose: rotations and positions, mm."""
    turned, position = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    x, y, z = np.eye(3)
    for i, (a, alpha, d, theta, beta) in enumerate(links):
        turned = turned @ rotation(x, alpha)
        position = position + turned[:, :, 0] * a
        turned = turned @ rotation(y, beta) @ rotation(z, q[:, i] + theta)
        position = position + turned[:, :, 2] * d
    return turned, position


def predicted(links, placement, session):
    """`placement`: three of the base, mm, its rotation vector, and three of each target, mm."""
    turned, position = flange(links, session["q"])
    offsets = placement[6:].reshape(-1, 3)
    in_base = position + np.einsum("nij,nj->ni", turned, offsets[session["target"]])
    return Rotation.from_rotvec(placement[3:6]).apply(in_base) + placement[:3]


def placed(links, session):
    """Base and targets with nominal links, best of 24 starting rotations."""
    of, best = {key: value[session["fitted"]] for key, value in session.items()}, None
    n_targets = session["target"].max() + 1
    for turn in Rotation.create_group("O"):
        middle = of["p"].mean(0) - turn.apply(flange(links, of["q"])[1].mean(0))
        start = np.concatenate([middle, turn.as_rotvec(), np.zeros(3 * n_targets)])
        fit = least_squares(lambda y: (of["p"] - predicted(links, y, of)).ravel(), start, x_scale="jac")
        if best is None or fit.cost < best.cost:
            best = fit
    return best.x


def fit(nominal, sessions):
    """Verify residuals of each session after one fit to all of them."""
    n = len(nominal)
    free = [(i, k) for i in range(n) for k in range(5) if k < 4 or (i > 0 and abs(np.sin(nominal[i, 1])) < NEARLY_PARALLEL)]
    placements = [placed(nominal, session) for session in sessions]
    ends = np.cumsum([len(free)] + [len(placement) for placement in placements])

    def links_of(x):
        links = nominal.copy()
        for value, (i, k) in zip(x, free):
            links[i, k] += value
        return links

    def residuals(x, fitted):
        links = links_of(x)
        of = lambda k: {key: value[sessions[k]["fitted"] == fitted] for key, value in sessions[k].items()}
        return [of(k)["p"] - predicted(links, x[ends[k] : ends[k + 1]], of(k)) for k in range(len(sessions))]

    start = np.concatenate([np.zeros(len(free)), *placements])
    found = least_squares(
        lambda x: np.concatenate([r.ravel() for r in residuals(x, True)]), start, x_scale="jac", tr_solver="exact", max_nfev=400, xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    return residuals(found.x, False)


def rms(residuals):
    return round(float(np.sqrt((residuals**2).sum(1).mean())), 6)


def main(robot, paths, alone):
    body = json.load(open(robot))
    joint_map = body.get("joint_map") or {}
    n = len(body["links"])
    nominal = np.array(
        [[link["a_mm"], np.radians(link["alpha_deg"]), link["d_mm"], np.radians(link["theta_offset_deg"]), np.radians(link.get("beta_deg") or 0)] for link in body["links"]]
    )
    sessions = [read(path) for path in paths]
    for session in sessions:
        q = session["q"] * np.array(joint_map.get("sign") or [1] * n)
        session["q"] = q @ np.array(joint_map.get("coupling") or np.eye(n)).T + np.radians(np.array(joint_map.get("offset_deg") or [0] * n))
    found = [fit(nominal, [session])[0] for session in sessions] if alone else fit(nominal, sessions)
    print(json.dumps(dict(verify_rms_mm=rms(np.concatenate(found)), by_session=[rms(r) for r in found])))


if __name__ == "__main__":
    files = [argument for argument in sys.argv[1:] if not argument.startswith("--")]
    main(files[0], files[1:], "--alone" in sys.argv)
