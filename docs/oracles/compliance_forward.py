"""Forward kinematics with corrections, written anew in numpy from the formula of docs/corrections.md with 4 x 4 matrices: an oracle for
kinematics/compliance.rs. Prints random robots, corrections and poses with the flange's pose, one case a line, as tests/core/kinematics/mod.rs reads them.

    python docs/oracles/compliance_forward.py > docs/oracles/compliance_forward.csv

A line: n, then per link a alpha d theta beta (mm, rad), q (n), g (3), m (n), c (3n), K (3n), B (3), coupling (n x n, row by row),
harmonics (4n: sin q, cos q, sin 2q, cos 2q), payload mass in units of mass and its centre (mm), then the flange's rotation row by row (9) and translation in mm (3).
"""

import numpy as np
from scipy.linalg import expm

random = np.random.default_rng(8)


def homogeneous(rotation=np.eye(3), translation=(0.0, 0.0, 0.0)):
    t = np.eye(4)
    t[:3, :3], t[:3, 3] = rotation, translation
    return t


def generator(w):
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def about(w):
    return homogeneous(expm(generator(np.asarray(w, float))))


def link(a, alpha, d, theta, beta, q):
    x, y, z = np.eye(3)
    return about(x * alpha) @ homogeneous(translation=(a, 0, 0)) @ about(y * beta) @ about(z * (q + theta)) @ homogeneous(translation=(0, 0, d))


for n in [1, 2, 3, 4, 6, 6, 6, 7, 12]:
    links = random.normal(size=(n, 5)) * [400.0, 1.5, 400.0, 1.5, 0.02]
    q, g, m = random.uniform(-3, 3, n), random.normal(size=3), random.uniform(0, 2, n)
    g /= np.linalg.norm(g)
    c, compliance, base = random.normal(size=(n, 3)) * 0.1, random.normal(size=(n, 3)) * 2e-3, random.normal(size=3) * 1e-3
    harmonics, coupling = random.normal(size=(n, 4)) * 3e-4, random.normal(size=(n, n)) * 5e-4
    payload, centre = random.uniform(0, 1), random.normal(size=3) * 100.0
    frames, at = [], np.eye(4)
    for i in range(n):
        at = at @ link(*links[i], q[i])
        frames.append(at)
    tip = (frames[-1] @ np.append(centre, 1.0))[:3]

    def moment(first, origin):
        """Sum of arm x force over every mass outboard; the first moment c_j is a mass at a small distance."""
        arms = [m[j] * (frames[j][:3, 3] - origin) / 1000.0 + frames[j][:3, :3] @ c[j] for j in range(first, n)]
        return sum(np.cross(arm, g) for arm in arms + [payload * (tip - origin) / 1000.0])

    at = about(base * moment(0, np.zeros(3)))
    for i in range(n):
        multiples = np.array([np.sin(q[i]), np.cos(q[i]), np.sin(2 * q[i]), np.cos(2 * q[i])])
        local = frames[i][:3, :3].T @ moment(i, frames[i][:3, 3])
        at = at @ link(*links[i], q[i] + coupling[i] @ q + harmonics[i] @ multiples) @ about(compliance[i] * local)
    parts = [[n], links.ravel(), q, g, m, c.ravel(), compliance.ravel(), base, coupling.ravel(), harmonics.ravel(), [payload], centre, at[:3, :3].ravel(), at[:3, 3]]
    print(",".join(repr(float(value)) for part in parts for value in part))
