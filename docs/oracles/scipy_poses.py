#!/usr/bin/env python3
"""What a user would write with scipy for poses: unregularised weighted least squares in six dimensions, compared with by `examples/study/poses.rs`.

    scipy_poses.py DIR      DIR as `cargo run --release --example study poses DIR` wrote it; prints one line of CSV for each set

Free are a, alpha, d, theta_offset of every link, beta where the nominal axes are nearly parallel, base and target (six numbers each). Rotation residuals
are log(R_predT * R_measured), times the weight of the set (mm/rad, in its name). Start: nominal links, base and target by Shah's closed form.
numpy and scipy from PyPI, in a virtual environment outside this repository."""
import csv, json, pathlib, sys
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation


def flange(links, q):
    """Flange poses in the base frame: Rx(alpha) Dx(a) Ry(beta) Rz(q + theta) Dz(d) of each link."""
    m = len(q); r = np.tile(np.eye(3), (m, 1, 1)); p = np.zeros((m, 3))
    for i, (a, alpha, d, theta, beta) in enumerate(links):
        p = p + r[:, :, 0] * a
        r = r @ Rotation.from_euler("XY", [alpha, beta]).as_matrix() @ Rotation.from_rotvec(np.outer(q[:, i] + theta, [0, 0, 1])).as_matrix()
        p = p + r[:, :, 2] * d
    return r, p


def nearest(m):
    u, _, vt = np.linalg.svd(m)
    return u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt


def closed_form(rf, pf, rm, pm):
    """Base and target: R_m X = Z R_f by the singular vectors of a Kronecker sum, then translations by linear least squares."""
    k = sum(np.kron(f.T, m.T) for f, m in zip(rf, rm))
    u, _, vt = np.linalg.svd(k)
    x, z = u[:, 0].reshape(3, 3, order="F"), vt[0].reshape(3, 3, order="F")
    sign = np.sign(np.linalg.det(x)); z, target = nearest(sign * z), nearest(sign * x).T
    a = np.concatenate([np.concatenate([np.eye(3), z @ f], axis=1) for f in rf]); b = (pm - pf @ z.T).ravel()
    t = np.linalg.lstsq(a, b, rcond=None)[0]
    return z, t[:3], target, t[3:]


def main(folder):
    print("set,position_rms_mm,rotation_rms_deg")
    for path in sorted(pathlib.Path(folder).glob("*.csv")):
        robot = json.load(open(path.with_suffix(".json")))
        links = np.array([[l["a_mm"], np.radians(l["alpha_deg"]), l["d_mm"], np.radians(l["theta_offset_deg"]), 0.0] for l in robot["links"]])
        rows = list(csv.DictReader(open(path))); col = lambda *names: np.array([[float(r[n]) for n in names] for r in rows])
        q = col(*[f"q{i + 1}_rad" for i in range(len(links))]); p = col("x_mm", "y_mm", "z_mm")
        r = Rotation.from_quat(col("quat_x", "quat_y", "quat_z", "quat_w")).as_matrix(); fit = np.array([row["subset"] == "identify" for row in rows])
        weight, reach = float(robot["mm_per_rad"]), np.abs(links[:, [0, 2]]).sum()
        free = [(i, k) for i in range(len(links)) for k in range(5) if k < 4 or (i > 0 and abs(np.sin(links[i, 1])) < 0.2)]; m = len(free)
        z, t, target, offset = closed_form(*flange(links, q[fit]), r[fit], p[fit])

        def residual(x, q, p, r):
            l = links.copy()
            for v, (i, k) in zip(x, free): l[i, k] += v * (reach if k in (0, 2) else 1)
            base, tool = Rotation.from_rotvec(x[m + 3:m + 6]).as_matrix() @ z, Rotation.from_rotvec(x[m + 9:m + 12]).as_matrix() @ target
            rf, pf = flange(l, q)
            at = t + x[m:m + 3] * reach + (pf + rf @ (offset + x[m + 6:m + 9] * reach)) @ base.T
            turned = Rotation.from_matrix(np.swapaxes(base @ rf @ tool, 1, 2) @ r).as_rotvec()
            return p - at, turned

        def whitened(x):
            position, rotation = residual(x, q[fit], p[fit], r[fit])
            return np.r_[position.ravel(), weight * rotation.ravel()]

        s = least_squares(whitened, np.zeros(m + 12), x_scale="jac", tr_solver="exact", max_nfev=300, xtol=1e-13, ftol=1e-13, gtol=1e-13)
        position, rotation = residual(s.x, q[~fit], p[~fit], r[~fit])
        rms = lambda v: np.sqrt((v**2).sum(1).mean())
        print(f"{path.stem},{rms(position):.6f},{np.degrees(rms(rotation)):.6f}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
