"""Priors and bounds on data/paper/first_noisy.csv by scipy: rows for the priors, scipy's own trust region with bounds.

    python docs/oracles/priors.py data/paper > docs/oracles/priors.csv

A second implementation: numerical derivatives, nothing shared with our code. The priors fix the four combinations that the positions do not
see (d_2 with d_3, theta_offset_6, theta_offset_5 with a_6, d_5 with alpha_6), so that the answer is one point.
"""
import csv
import json
import pathlib
import sys

import numpy as np
from scipy.optimize import least_squares

# name: mean and standard deviation from nominal, lower and upper bound from nominal; mm or degrees
PRIORS = {
    "d_2": (0.0, 0.05, -np.inf, np.inf),
    "theta_offset_6": (0.1, 0.02, -np.inf, np.inf),
    "a_6": (0.2, 0.1, -np.inf, np.inf),
    "d_5": (0.3, 0.1, -np.inf, np.inf),
    "a_3": (0.0, 0.02, -np.inf, np.inf),
    "alpha_2": (0.0, 0.002, -np.inf, np.inf),
}
BOUNDED = PRIORS | {
    "a_4": (0.0, 10.0, -0.02, 0.02),
    "a_2": (0.0, 10.0, -0.01, 0.1),
    "theta_offset_3": (0.0, 1.0, -1.0, 0.001),
    "d_5": (0.3, 0.1, 0.0, 0.32),
}


def positions(links, q):
    """Rx(alpha) Dx(a) Rz(q + theta) Dz(d) of every pose, mm."""
    rotation, position = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    for i, (a, alpha, d, theta) in enumerate(links):
        ca, sa, c, s = np.cos(alpha), np.sin(alpha), np.cos(q[:, i] + theta), np.sin(q[:, i] + theta)
        zero = np.zeros_like(c)
        step = np.stack([np.stack([c, -s, zero], 1), np.stack([ca * s, ca * c, zero - sa], 1), np.stack([sa * s, sa * c, zero + ca], 1)], 1)
        position = position + np.einsum("nij,j->ni", rotation, np.array([a, -sa * d, ca * d]))
        rotation = rotation @ step
    return position


def main(folder):
    robot = json.loads((folder / "robot.json").read_text())
    keys = ["a_mm", "alpha_deg", "d_mm", "theta_offset_deg"]
    nominal = np.array([[link.get(k, 0.0) for k in keys] for link in robot["links"]])
    names = [f"{k.rsplit('_', 1)[0]}_{i + 1}" for i in range(len(nominal)) for k in keys]
    rows = [r for r in csv.DictReader(open(folder / "first_noisy.csv")) if r["subset"] == "identify"]
    unit = "deg" if "q1_deg" in rows[0] else "rad"
    q = np.array([[float(r[f"q{i + 1}_{unit}"]) for i in range(len(nominal))] for r in rows])
    q = np.radians(q) if unit == "deg" else q
    measured = np.array([[float(r[f"{axis}_mm"]) for axis in "xyz"] for r in rows])

    def residuals(x):
        links = nominal + x.reshape(nominal.shape)
        links[:, 1::2] = np.radians(links[:, 1::2])
        return (measured - positions(links, q)).ravel()

    print("case,name,deviation")
    for case, priors in [("priors", PRIORS), ("bounds", BOUNDED)]:
        at = [names.index(n) for n in priors]
        mean, std, low, high = (np.array([p[k] for p in priors.values()]) for k in range(4))
        lower, upper = np.full(len(names), -np.inf), np.full(len(names), np.inf)
        lower[at], upper[at] = low, high

        def fit(x, sigma):
            f = lambda x: np.concatenate([residuals(x), sigma / std * (mean - x[at])])
            return least_squares(f, x, bounds=(lower, upper), jac="3-point", x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=500).x

        def noise(x, sigma):
            """sigma^2 = F / (rows - gamma) [MacKay 1992]: gamma counts what the rows determine of the parameters beside their priors."""
            steps = np.full(len(x), 1e-6)
            columns = [(residuals(x + e) - residuals(x - e)) / 2e-6 for e in np.diag(steps)]
            at_bound = (x - lower < 1e-7) | (upper - x < 1e-7)
            free = np.flatnonzero(~at_bound)
            precision = np.zeros(len(x))
            precision[at] = 1 / std**2
            jacobian = np.array(columns).T[:, free]
            covariance = np.linalg.inv(jacobian.T @ jacobian / sigma**2 + np.diag(precision[free]))
            gamma = len(free) - np.sum(np.diag(covariance) * precision[free])
            return np.sqrt(np.sum(residuals(x) ** 2) / (3 * len(q) - gamma))

        # from below
        x, sigma = np.zeros(len(names)), 1e-3
        for _ in range(50):
            x = fit(np.clip(x, lower + 1e-9, upper - 1e-9), sigma)
            following = noise(x, sigma)
            if abs(sigma - following) <= 1e-9 * following:
                break
            sigma = following
        print(f"{case},sigma_mm,{sigma!r}".replace("np.float64(", "").replace(")", ""))
        for name, value in zip(names, x):
            print(f"{case},{name},{float(value)!r}")


main(pathlib.Path(sys.argv[1]))
