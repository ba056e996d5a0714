"""Moves every ready arm beside the public description that it comes from, and writes the table of docs/robot-models.md.

    python docs/oracles/robot_models.py ../shared/data/urdf            compares; exit code 1 where an unnamed difference is above 0.01 mm
    python docs/oracles/robot_models.py ../shared/data/urdf --write    and writes the table

Descriptions are moved by pinocchio (PyPI: pin), without it by the reader of read_ur_description.py; the library's links by the product of docs/notation.md
in a few lines here. Shares nothing with kincal but data/robot-models. Joint values are the pendant's; what FANUC and ABB's linkage arms show for
joint 3 is turned into the description's by hand.
"""

import json
import math
import pathlib
import random
import sys
import xml.etree.ElementTree as ElementTree

from read_ur_description import pose, times

try:
    import pinocchio
except ImportError:
    pinocchio = None

HERE = pathlib.Path(__file__).resolve().parent
LIBRARY = HERE.parent.parent / "data" / "robot-models"
PAGE = HERE.parent / "robot-models.md"
SAME_MM = 0.01
POSTURES = 200
BEGIN, END = "<!-- table: made by docs/oracles/robot_models.py -->", "<!-- end of the table -->"


def models():
    return [model for file in sorted(LIBRARY.glob("*.json")) for model in json.loads(file.read_text())]


def links(model, pendant):
    """Flange in the base: Rx(alpha)·Dx(a)·Rz(q + theta)·Dz(d) over the links, q through the joint map."""
    robot, n = model["robot"], len(pendant)
    joint_map = robot.get("joint_map", {})
    sign = joint_map.get("sign", [1] * n)
    coupling = joint_map.get("coupling", [[i == j for j in range(n)] for i in range(n)])
    t = pose([0, 0, 0], [0, 0, 0])
    for link, row in zip(robot["links"], coupling):
        q = sum(c * s * v for c, s, v in zip(row, sign, pendant)) + math.radians(link["theta_offset_deg"])
        t = times(t, pose([link["a_mm"], 0, 0], [math.radians(link["alpha_deg"]), 0, 0]))
        t = times(t, pose([0, 0, link["d_mm"]], [0, 0, q]))
    return t


def described_joints(model, pendant):
    q = list(pendant)
    if model["maker"] == "FANUC":
        q[2] += q[1]
    if model["id"] == "abb_irb_2400_16_155":
        q[2] -= q[1]
    return q


def path(tree, link):
    by_child = {joint.find("child").get("link"): joint for joint in tree.getroot().findall("joint")}
    joints = []
    while link in by_child:
        joints.insert(0, by_child[link])
        link = joints[0].find("parent").get("link")
    return joints


def by_hand(tree, base, tip):
    def walk(link, q):
        t, values = pose([0, 0, 0], [0, 0, 0]), iter(q)
        for joint in path(tree, link):
            origin = joint.find("origin")
            three = lambda name: [float(v) for v in ((origin.get(name) if origin is not None else None) or "0 0 0").split()]
            t = times(t, pose([1e3 * v for v in three("xyz")], three("rpy")))
            if joint.get("type") != "fixed":
                x, y, z = (float(v) for v in joint.find("axis").get("xyz").split())
                t = times(t, about(x, y, z, next(values)))
        return t

    inverse = inverted(walk(base, []))
    return lambda q: times(inverse, walk(tip, q))


def about(x, y, z, angle):
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z, s, c = x / length, y / length, z / length, math.sin(angle), math.cos(angle)
    d = 1 - c
    return [
        [c + x * x * d, x * y * d - z * s, x * z * d + y * s, 0],
        [y * x * d + z * s, c + y * y * d, y * z * d - x * s, 0],
        [z * x * d - y * s, z * y * d + x * s, c + z * z * d, 0],
        [0, 0, 0, 1],
    ]


def inverted(t):
    turned = [[t[j][i] for j in range(3)] for i in range(3)]
    moved = [-sum(turned[i][k] * t[k][3] for k in range(3)) for i in range(3)]
    return [turned[i] + [moved[i]] for i in range(3)] + [[0, 0, 0, 1]]


def by_pinocchio(tree, base, tip):
    model = pinocchio.buildModelFromXML(ElementTree.tostring(tree.getroot(), encoding="unicode"))
    data, names = model.createData(), [j.get("name") for j in path(tree, tip) if j.get("type") != "fixed"]
    base, tip = model.getFrameId(base), model.getFrameId(tip)

    def flange(q):
        configuration = pinocchio.neutral(model)
        for name, value in zip(names, q):
            joint = model.joints[model.getJointId(name)]
            configuration[joint.idx_q : joint.idx_q + joint.nq] = [value] if joint.nq == 1 else [math.cos(value), math.sin(value)]
        pinocchio.framesForwardKinematics(model, data, configuration)
        t = (data.oMf[base].inverse() * data.oMf[tip]).homogeneous.tolist()
        for row in t[:3]:
            row[3] *= 1e3
        return t

    return flange


def apart_mm(a, b):
    """Distance of the origins, or of points 100 mm beside them."""
    points = ([0, 0, 0, 1], [100, 0, 0, 1], [0, 100, 0, 1])
    return max(math.dist(*([sum(r * v for r, v in zip(row, p)) for row in t[:3]] for t in (a, b))) for p in points)


def compare(model, source, folder):
    tree = ElementTree.parse(folder / f"{source['document']}.urdf")
    reader = by_pinocchio if pinocchio is not None else by_hand
    described = reader(tree, source["base_link"], source["tip_link"])
    draw, worst = random.Random(model["id"]), 0.0
    for _ in range(POSTURES):
        limits = [link.get("joint_limits_deg", [-170, 170]) for link in model["robot"]["links"]]
        pendant = [math.radians(draw.uniform(*limit)) for limit in limits]
        worst = max(worst, apart_mm(links(model, pendant), described(described_joints(model, pendant))))
    return worst


def table(found):
    lines = [BEGIN, "", "| maker | arm | id | joints | sources | against the description |", "|---|---|---|---|---|---|"]
    for model, results in found:
        if results:
            told = "; ".join(f"{mm:.3f} mm: {source['cause']}" if mm > SAME_MM else "0.00 mm" for source, mm in results)
        else:
            told = "none public here; moves as its second source"
        titles = "; ".join(source["title"] for source in model["sources"])
        lines.append(f"| {model['maker']} | {model['name']} | `{model['id']}` | {len(model['joints'])} | {titles} | {told} |")
    return lines + ["", END]


def main(folder, *options):
    found, wrong = [], []
    for model in models():
        results = []
        for source in model["sources"]:
            if "document" not in source:
                continue
            mm = compare(model, source, pathlib.Path(folder))
            results.append((source, mm))
            if mm > SAME_MM:
                print(f"{model['id']}: {mm:.3f} mm, {source.get('cause', 'NOT NAMED')}")
            if mm > SAME_MM and "cause" not in source:
                wrong.append(model["id"])
        found.append((model, results))
    n = sum(len(results) for _, results in found)
    reader = f"pinocchio {pinocchio.__version__}" if pinocchio is not None else "the reader here"
    print(f"{len(found)} arms, {n} descriptions moved by {reader}, {POSTURES} postures each, {len(wrong)} unnamed differences above {SAME_MM} mm")
    if "--write" in options:
        text = PAGE.read_text()
        before, rest = text.split(BEGIN)
        PAGE.write_text(before + "\n".join(table(found)) + rest.split(END)[1])
    return 1 if wrong or not n else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
