"""Reads a parameter set's exports with other people's readers (json, csv, ElementTree, PyYAML) and moves them side by side.

    for f in json yaml csv urdf; do curl -s "$SERVER/v1/parameter-sets/$ID/export?format=$f" > set.$f; done
    python docs/oracles/read_exports.py set.json set.yaml set.csv set.urdf

Prints the largest difference of the flange from the JSON's links over 200 random configurations, mm, and of an entry of its rotation, and ends with 1 where that is above
1e-9 mm or 1e-12. YAML needs PyYAML and is left out, by name, without it; tests/service/api/export.rs runs the rest. For ur_kinematics see read_ur_description.py.
"""

import csv
import json
import math
import random
import sys
import xml.etree.ElementTree as ElementTree

try:
    import yaml
except ImportError:
    yaml = None


def times(*matrices):
    product = matrices[0]
    for m in matrices[1:]:
        product = [[sum(row[k] * m[k][j] for k in range(4)) for j in range(4)] for row in product]
    return product


def turn(axis, angle):
    m = shift(0, 0, 0)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    c, s = math.cos(angle), math.sin(angle)
    m[j][j], m[j][k], m[k][j], m[k][k] = c, -s, s, c
    return m


def shift(x, y, z):
    return [[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z], [0, 0, 0, 1]]


def by_links(links):
    rows = [{name: float(value) for name, value in link.items() if name.endswith(("_mm", "_deg"))} for link in links]

    def flange(q):
        t = shift(0, 0, 0)
        for link, value in zip(rows, q):
            t = times(t, turn(0, math.radians(link["alpha_deg"])), shift(link["a_mm"], 0, 0), turn(1, math.radians(link["beta_deg"])))
            t = times(t, turn(2, value + math.radians(link["theta_offset_deg"])), shift(0, 0, link["d_mm"]))
        return t

    return flange


def origin(xyz_m, rpy):
    return times(shift(*(1e3 * metres for metres in xyz_m)), turn(2, rpy[2]), turn(1, rpy[1]), turn(0, rpy[0]))


def by_urdf(path):
    joints = {}
    for joint in ElementTree.parse(path).getroot().findall("joint"):
        joints[joint.find("parent").get("link"), joint.get("type") == "fixed"] = joint
    link, chain = "base_link", []
    while (link, False) in joints:
        joint = joints[link, False]
        numbers = lambda tag, name: [float(v) for v in joint.find(tag).get(name).split()]
        x, y, z = numbers("axis", "xyz")
        if (x, y, abs(z)) != (0, 0, 1):
            sys.exit(f"{path}: joint {joint.get('name')} does not turn about z")
        chain.append((origin(numbers("origin", "xyz"), numbers("origin", "rpy")), z))
        link = joint.find("child").get("link")
    return by_chain(chain)


def by_chain(chain):
    def flange(q):
        if len(q) != len(chain):
            sys.exit(f"{len(chain)} joints instead of {len(q)}")
        t = shift(0, 0, 0)
        for (pose, sign), value in zip(chain, q):
            t = times(t, pose, turn(2, sign * value))
        return t

    return flange


def reader(path):
    kind = path.rsplit(".", 1)[1]
    if kind == "json":
        return by_links(json.load(open(path))["links"])
    if kind == "csv":
        return by_links(list(csv.DictReader(open(path))))
    if kind == "urdf":
        return by_urdf(path)
    if yaml is None:
        return None
    return by_links(yaml.safe_load(open(path))["links"])


if __name__ == "__main__":
    meant, *others = [(path, reader(path)) for path in sys.argv[1:]]
    n = len(json.load(open(meant[0]))["links"])
    draw = random.Random(0)
    configurations = [[draw.uniform(-math.pi, math.pi) for _ in range(n)] for _ in range(200)]
    wrong = False
    for path, flange in others:
        if flange is None:
            print(f"{path:20} left out: PyYAML is not here")
            continue
        mm = rotation = 0.0
        for q in configurations:
            found, expected = flange(q), meant[1](q)
            mm = max(mm, math.dist(*([row[3] for row in m[:3]] for m in (found, expected))))
            rotation = max([rotation] + [abs(found[i][j] - expected[i][j]) for i in range(3) for j in range(3)])
        wrong |= not (mm < 1e-9 and rotation < 1e-12)
        print(f"{path:20} {mm:.1e} mm  {rotation:.1e}")
    sys.exit(wrong)
