"""Simulated uploads of 25 and 60 poses, with and without sag, and how near a maximum a posteriori fit of the true model to all points comes.

    python docs/oracles/final_fit.py OUT > docs/oracles/final_fit.csv

OUT gets a folder for each case with robot.json, set.csv (instrument frame, no subset column) and unseen.csv (200 other poses, positions without
noise); `examples/study/final_fit.rs` reads them. The oracle knows the standard deviations of link errors and noise, and, of a robot that sags, the
masses and which joints give. Nothing is shared with kincal's code: 4 x 4 matrices, numerical derivatives. The csv has the oracle's rms at the
unseen poses, mm.
"""

import json
import pathlib
import sys

import numpy as np
from scipy.optimize import least_squares

ARMS = {  # a mm, alpha deg, d mm, theta_offset deg
    "er20": [(0, 0, 504, 0), (166.605, -90, 0, 0), (782.27, 0, 0, 0), (138.826, -90, 761.35, 0), (0, 90, 0, 0), (0, -90, 125, 0)],
    "ma1400": [(0, 0, 450, 0), (150, -90, 0, -90), (614, 180, 0, 0), (200, -90, -640, 0), (0, 90, 0, -90), (30, 90, 200, 0)],
    "ur10": [(0, 0, 128, 0), (0, 90, 0, 0), (-612, 0, 0, 0), (-572, 0, 164, 0), (0, 90, 116, 0), (0, -90, 92, 0)],
    "irb": [(0, 0, 495, 0), (175, -90, 0, -90), (900, 0, 0, 0), (175, -90, 960, 0), (0, 90, 0, 0), (0, -90, 135, 180)],
}
LENGTH_MM, ANGLE, NOISE_MM = 0.3, np.radians(0.05), 0.03
SAG, SAG_STD = 0.3e-3, 0.1e-3  # rad per unit moment
MASSES = {2: 1.0, 4: 1.0, 5: 0.5}  # at the origins of these frames
GIVING = [1, 2]
TARGET = np.array([60.0, -40.0, 100.0])
UNSEEN = 200


def rotation(axis, angle):
    r = np.tile(np.eye(4), (len(angle), 1, 1))
    j, k = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(angle), np.sin(angle)
    r[:, j, j], r[:, j, k], r[:, k, j], r[:, k, k] = c, -s, s, c
    return r


def shift(n, *xyz):
    t = np.tile(np.eye(4), (n, 1, 1))
    t[:, :3, 3] = xyz
    return t


def frames(links, q):
    n, at, found = len(q), np.tile(np.eye(4), (len(q), 1, 1)), []
    for i, (a, alpha, d, theta, beta) in enumerate(links):
        same = lambda angle: np.full(n, angle)
        at = at @ rotation(0, same(alpha)) @ shift(n, a, 0, 0) @ rotation(1, same(beta)) @ rotation(2, q[:, i] + theta) @ shift(n, 0, 0, d)
        found.append(at)
    return found


def sagged(links, q, compliance):
    """Joint values with what the moments of gravity (-z of the base) about the axes add to them."""
    if not np.any(compliance):
        return q
    at, q = frames(links, q), q.copy()
    down = np.array([0.0, 0.0, -1.0])
    for joint, c in zip(GIVING, compliance):
        axis, origin = at[joint][:, :3, 2], at[joint][:, :3, 3]
        moment = sum(m * np.cross((at[k][:, :3, 3] - origin) / 1000, down) for k, m in MASSES.items() if k >= joint)
        q[:, joint] += c * np.einsum("ij,ij->i", axis, moment)
    return q


def positions(links, compliance, base, target, q):
    n, same = len(q), lambda angle: np.full(len(q), angle)
    t = shift(n, *base[:3]) @ rotation(2, same(base[5])) @ rotation(1, same(base[4])) @ rotation(0, same(base[3]))
    return (t @ frames(links, sagged(links, q, compliance))[-1] @ np.append(target, 1.0))[:, :3]


def oracle(nominal, truth, q, measured, has_sag):
    """Maximum a posteriori of the true model, from the truth on; links, base and target that it finds."""
    n = nominal.size
    widths = np.tile([LENGTH_MM, ANGLE, LENGTH_MM, ANGLE, ANGLE], len(nominal))
    n_sag = len(GIVING) if has_sag else 0

    def parts(x):
        compliance = SAG + x[n : n + n_sag] * SAG_STD * 3 if has_sag else np.zeros(len(GIVING))
        base = truth["base"] + x[n + n_sag : n + n_sag + 6] * [1, 1, 1, 1e-3, 1e-3, 1e-3]
        return nominal + (x[:n] * widths).reshape(nominal.shape), compliance, base, truth["target"] + x[n + n_sag + 6 :]

    def residuals(x):
        return np.r_[(measured - positions(*parts(x), q)).ravel() / NOISE_MM, x[: n + n_sag]]

    start = np.zeros(n + n_sag + 9)
    return parts(least_squares(residuals, start, x_scale="jac", xtol=1e-12, ftol=1e-12).x)


def link(row):
    a, alpha, d, theta, beta = (float(v) for v in row)
    return dict(a_mm=a, alpha_deg=np.degrees(alpha), d_mm=d, theta_offset_deg=np.degrees(theta), beta_deg=np.degrees(beta))


def write(path, q, p):
    head = ",".join(f"q{i + 1}_rad" for i in range(q.shape[1])) + ",x_mm,y_mm,z_mm"
    rows = [",".join([*(f"{v:.9f}" for v in q[i]), *(f"{v:.7f}" for v in p[i])]) for i in range(len(q))]
    path.write_text("\n".join([head, *rows]) + "\n")


def main(out):
    print("case,oracle_rms_mm")
    for arm, (name, rows) in enumerate(ARMS.items()):
        nominal = np.array([[a, np.radians(al), d, np.radians(t), 0.0] for a, al, d, t in rows])
        for seed in range(4):
            for n_poses in (25, 60):
                for has_sag in (False, True):
                    random = np.random.default_rng([7, arm, seed, n_poses, has_sag])
                    links = nominal + random.normal(size=nominal.shape) * [LENGTH_MM, ANGLE, LENGTH_MM, ANGLE, ANGLE]
                    compliance = SAG + SAG_STD * random.normal(size=len(GIVING)) if has_sag else np.zeros(len(GIVING))
                    truth = dict(base=np.r_[random.uniform(-2000, 2000, 3), 0, 0, random.uniform(-3, 3)], target=TARGET)
                    q = random.uniform(-1.4, 1.4, (n_poses + UNSEEN, len(nominal)))
                    p = positions(links, compliance, truth["base"], TARGET, q)
                    measured = p[:n_poses] + random.normal(0, NOISE_MM, (n_poses, 3))
                    found = oracle(nominal, truth, q[:n_poses], measured, has_sag)
                    wrong = positions(*found, q[n_poses:]) - p[n_poses:]
                    case = f"{name}.{seed}.{n_poses}.{'sag' if has_sag else 'rigid'}"
                    folder = out / case
                    folder.mkdir(parents=True, exist_ok=True)
                    (folder / "robot.json").write_text(json.dumps(dict(name=name, links=[link(row) for row in nominal])))
                    write(folder / "set.csv", q[:n_poses], measured)
                    write(folder / "unseen.csv", q[n_poses:], p[n_poses:])
                    print(f"{case},{np.sqrt((wrong**2).sum(1).mean()):.5f}", flush=True)


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]))
