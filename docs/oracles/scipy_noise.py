#!/usr/bin/env python3
"""What a user would write with scipy for points with covariances: weighted least squares, compared with by `examples/study/noise.rs`.

    scipy_noise.py DIR      DIR as `cargo run --release --example study noise DIR` wrote it; prints one line of CSV for each set

Free are all five numbers of every link, base and target. Residuals are whitened by the Cholesky factor of the inverse of each point's true covariance.
What the points cannot tell apart is settled by priors: a thousand times as wide as the robots' errors (`wls_mm`: plain weighted least squares), and as
wide as these (`map_mm`: nobody who knows no more can do better on average). Printed is the root mean square error at unseen poses, mm.
Start: the nominal links, the base by Kabsch's fit. numpy and scipy from PyPI, in a virtual environment outside this repository."""
import pathlib, sys
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation


def tool(links, q, target):
    """Target in the base frame: Rx(alpha) Dx(a) Ry(beta) Rz(q + theta) Dz(d) of each link."""
    m = len(q); r = np.tile(np.eye(3), (m, 1, 1)); p = np.zeros((m, 3))
    for i, (a, alpha, d, theta, beta) in enumerate(links):
        r = r @ Rotation.from_rotvec([alpha, 0, 0]).as_matrix()
        p = p + r[:, :, 0] * a
        r = r @ Rotation.from_rotvec([0, beta, 0]).as_matrix() @ Rotation.from_rotvec(np.outer(q[:, i] + theta, [0, 0, 1])).as_matrix()
        p = p + r[:, :, 2] * d
    return p + r @ target


def kabsch(a, b):
    u, _, vt = np.linalg.svd((b - b.mean(0)).T @ (a - a.mean(0)))
    r = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    return r, b.mean(0) - r @ a.mean(0)


def main(folder):
    print("case,wls_mm,map_mm")
    for path in sorted(pathlib.Path(folder).glob("*_*_*.txt")):
        rows = [line.split(",") for line in path.read_text().splitlines()]
        of = lambda kind: np.array([[float(v) for v in r[1:]] for r in rows if r[0] == kind])
        links, points, unseen = of("link"), of("point"), of("unseen"); n = len(links)
        q, p, covariance = points[:, :n], points[:, n:n + 3], points[:, n + 3:].reshape(-1, 3, 3)
        white = np.linalg.cholesky(np.linalg.inv(covariance)).transpose(0, 2, 1)
        reach = np.abs(links[:, [0, 2]]).sum()
        width = np.tile([0.5 / 1700 * reach, np.radians(0.05), 0.5 / 1700 * reach, np.radians(0.3), np.radians(0.05)], n)
        r0, t0 = kabsch(tool(links, q, np.zeros(3)), p)

        def model(x, q):
            l = links + (x[:5 * n] * width).reshape(n, 5)
            base = Rotation.from_rotvec(x[5 * n:5 * n + 3]).as_matrix() @ r0
            return t0 + x[5 * n + 3:5 * n + 6] * reach + tool(l, q, x[5 * n + 6:] * reach) @ base.T

        errors = []
        for wide in (1e3, 1.0):
            residual = lambda x: np.r_[np.einsum("nij,nj->ni", white, p - model(x, q)).ravel(), x[:5 * n] / wide]
            s = least_squares(residual, np.zeros(5 * n + 9), x_scale="jac", tr_solver="exact", max_nfev=300, xtol=1e-13, ftol=1e-13, gtol=1e-13)
            errors.append(np.sqrt(((model(s.x, unseen[:, :n]) - unseen[:, n:]) ** 2).sum(1).mean()))
        print(path.stem + "," + ",".join(f"{e:.6f}" for e in errors), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
