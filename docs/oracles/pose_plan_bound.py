"""How much better than random poses a plan can be at all: the approximate design of the same criterion.

    python docs/oracles/pose_plan_bound.py

For robots, joint limits and numbers of poses: the root of the mean variance of the tool over the workspace with random poses (median of 20
draws) and with the best weights on 1,600 candidates (multiplicative algorithm; Silvey, Titterington & Torsney 1978). No choice among these
candidates does better than such weights: a real plan has whole poses. Derivatives are central differences; nothing is shared with kincal's code.
"""

import numpy as np

rng = np.random.default_rng(0)
NOISE_MM = 0.05


def turn(axis, angle):
    m = np.tile(np.eye(4), (len(angle), 1, 1))
    j, k = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(angle), np.sin(angle)
    m[:, j, j], m[:, j, k], m[:, k, j], m[:, k, k] = c, -s, s, c
    return m


def shift(n, *xyz):
    m = np.tile(np.eye(4), (n, 1, 1))
    m[:, :3, 3] = xyz
    return m


def position(links, base, tool, q):
    n = len(q)
    same = lambda angle: np.full(n, angle)
    t = shift(n, *base[:3]) @ turn(0, same(base[3])) @ turn(1, same(base[4])) @ turn(2, same(base[5]))
    for i, (a, alpha, d, theta, beta) in enumerate(links):
        t = t @ turn(0, same(alpha)) @ shift(n, a, 0, 0) @ turn(1, same(beta)) @ turn(2, q[:, i] + theta) @ shift(n, 0, 0, d)
    return (t @ np.append(tool, 1))[:, :3]


def parameters(links):
    """The complete model's (docs/notation.md)."""
    n, parallel = len(links), [abs(np.sin(link[1])) < 0.02 for link in links]

    def d_is_free(i):
        first = last = i
        while first > 0 and parallel[first]:
            first -= 1
        while last + 1 < n and parallel[last + 1]:
            last += 1
        return first != 0 and last != n - 1 and first == i

    found = [("base", k) for k in range(6)]
    for i in range(1, n):
        found += [(i, 0), (i, 1)]
        found += [(i, 2)] if i != n - 1 and d_is_free(i) else []
        found += [(i, 3)] if i != n - 1 else []
        found += [(i, 4)] if parallel[i] else []
    return found + [("tool", k) for k in range(3)]


def jacobian(links, tool, q):
    """By parameters in units of their priors: 1 mm, 0.3 degrees, 10 mm for base and tool."""
    columns = []
    for where, k in parameters(links):
        def at(step):
            moved, base, target = [list(link) for link in links], np.zeros(6), np.array(tool, float)
            {"base": base, "tool": target}.get(where, moved[where] if where not in ("base", "tool") else None)[k] += step
            return position(moved, base, target, q)

        is_angle = k > 2 if where == "base" else where != "tool" and k in (1, 3, 4)
        step = 1e-5 if is_angle else 1e-2
        scale = np.radians(0.3) if is_angle else 10 if where in ("base", "tool") else 1
        columns.append((at(step) - at(-step)) / (2 * step) * scale)
    return np.stack(columns, 2)


ROBOTS = {
    "paper": [[0, 0, 504, 0], [166.605, -90, 0, 0], [782.27, 0, 0, 0], [138.826, -90, 761.35, 0], [0, 90, 0, 0], [0, -90, 125, 0]],
    "cobot": [[0, 0, 127.3, 0], [0, 90, 0, 0], [-612, 0, 0, 0], [-572.3, 0, 163.9, 0], [0, 90, 115.7, 0], [0, -90, 92.2, 0]],
}
LIMITS_DEG = [[149, 57, 63, 160, 97, 172], [160] * 6, [90] * 6]

for name, table in ROBOTS.items():
    links = [[a, np.radians(alpha), d, np.radians(theta), 0] for a, alpha, d, theta in table]
    for limits in LIMITS_DEG:
        draw = lambda n: rng.uniform(-1, 1, (n, 6))
        rad = np.radians(limits)
        interest = jacobian(links, [80, 0, 100], draw(400) * rad)
        interest = np.einsum("nij,nik->jk", interest, interest) / 400
        candidates = np.concatenate([draw(800), np.sin(np.pi / 2 * draw(800))]) * rad
        rows = jacobian(links, [80, 0, 100], candidates) / NOISE_MM
        prior = np.eye(rows.shape[2])
        std = lambda information: np.sqrt(np.trace(np.linalg.solve(information + prior, interest)))
        weights = np.full(len(rows), 1 / len(rows))
        for _ in range(60):
            covariance = np.linalg.inv(50 * np.einsum("n,nij,nik->jk", weights, rows, rows, optimize=True) + prior)
            gain = np.einsum("nij,jk,nik->n", rows, covariance @ interest @ covariance, rows, optimize=True)
            weights *= np.sqrt(gain)
            weights /= weights.sum()
        of = lambda chosen: std(np.einsum("nij,nik->jk", chosen, chosen))
        told = []
        for n in (15, 20, 30, 50):
            random = np.median([of(rows[rng.choice(800, n, False)]) for _ in range(20)])
            best = std(n * np.einsum("n,nij,nik->jk", weights, rows, rows, optimize=True))
            told.append(f"{n}: {random:.4f}/{best:.4f} = {random / best:.2f}")
        print(name, limits[:4], "  ".join(told), flush=True)
