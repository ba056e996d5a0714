"""Loads a description of Universal Robots with the joint origins of an exported ur_kinematics file, and says where it has its tool.

    curl -s "$SERVER/v1/parameter-sets/$ID/export?format=ur_kinematics" > ur.yaml
    python docs/oracles/read_ur_description.py ur10e.urdf ur.yaml configurations.json

ur10e.urdf is the maker's description (ur_description, xacro expanded); configurations.json is a list of lists of six joint values, rad. Prints
{"readers": [...], "t_base_link_tool0": [4 x 4, mm, for each configuration]}. With pinocchio (PyPI: pin) installed both it and a reader of a few lines here
move the robot, and the answer is 1 where they differ by more than 1e-9 mm; without it there is the reader here alone. Shares nothing with kincal.
"""

import json
import math
import sys
import xml.etree.ElementTree as ElementTree

try:
    import pinocchio
except ImportError:
    pinocchio = None

JOINTS = {
    "shoulder": "shoulder_pan_joint",
    "upper_arm": "shoulder_lift_joint",
    "forearm": "elbow_joint",
    "wrist_1": "wrist_1_joint",
    "wrist_2": "wrist_2_joint",
    "wrist_3": "wrist_3_joint",
}


def read_kinematics(path):
    """The numbers of a file of two levels, by its indents: {frame: {x, y, z, roll, pitch, yaw}}."""
    frames, frame = {}, None
    for line in open(path):
        line = line.split("#")[0].rstrip()
        indent, (name, _, value) = len(line) - len(line.lstrip()), line.strip().partition(":")
        if indent == 2 and not value.strip():
            frame = frames[name] = {}
        elif indent == 4:
            frame[name] = float(value)
    return frames


def with_origins(urdf, frames):
    """The description with these origins in place of the joints' own, as xacro puts them in."""
    tree = ElementTree.parse(urdf)
    joints = {joint.get("name"): joint for joint in tree.getroot().findall("joint")}
    for frame, joint in JOINTS.items():
        origin = joints[joint].find("origin")
        origin.set("xyz", " ".join(repr(frames[frame][k]) for k in "xyz"))
        origin.set("rpy", " ".join(repr(frames[frame][k]) for k in ("roll", "pitch", "yaw")))
    return tree


def times(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(4)) for j in range(4)] for i in range(4)]


def pose(xyz, rpy):
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(v), math.sin(v)) for v in rpy)
    return [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, xyz[0]],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, xyz[1]],
        [-sp, cp * sr, cp * cr, xyz[2]],
        [0, 0, 0, 1],
    ]


def by_hand(tree, q):
    by_child = {joint.find("child").get("link"): joint for joint in tree.getroot().findall("joint")}
    link, path = "tool0", []
    while link != "base_link":
        path.insert(0, by_child[link])
        link = path[0].find("parent").get("link")
    values = dict(zip(JOINTS.values(), q))
    t = pose([0, 0, 0], [0, 0, 0])
    for joint in path:
        numbers = lambda name: [float(v) for v in joint.find("origin").get(name, "0 0 0").split()]
        t = times(t, pose([1e3 * v for v in numbers("xyz")], numbers("rpy")))
        if joint.get("type") != "fixed":
            assert joint.find("axis").get("xyz").split() == ["0", "0", "1"], joint.get("name")
            t = times(t, pose([0, 0, 0], [0, 0, values[joint.get("name")]]))
    return t


def by_pinocchio(tree):
    model = pinocchio.buildModelFromXML(ElementTree.tostring(tree.getroot(), encoding="unicode"))
    data = model.createData()
    base, tool = model.getFrameId("base_link"), model.getFrameId("tool0")

    def flange(q):
        configuration = pinocchio.neutral(model)
        for name, value in zip(JOINTS.values(), q):
            joint = model.joints[model.getJointId(name)]
            # a continuous joint is kept as cosine and sine
            configuration[joint.idx_q : joint.idx_q + joint.nq] = [value] if joint.nq == 1 else [math.cos(value), math.sin(value)]
        pinocchio.framesForwardKinematics(model, data, configuration)
        t = (data.oMf[base].inverse() * data.oMf[tool]).homogeneous.tolist()
        for row in t[:3]:
            row[3] *= 1e3
        return t

    return flange


if __name__ == "__main__":
    urdf, kinematics, configurations = sys.argv[1:]
    tree = with_origins(urdf, read_kinematics(kinematics))
    configurations = json.load(open(configurations))
    poses, readers = [by_hand(tree, q) for q in configurations], ["by hand"]
    if pinocchio is not None:
        readers.append(f"pinocchio {pinocchio.__version__}")
        flange = by_pinocchio(tree)
        for q, by_hand_t in zip(configurations, poses):
            apart = max(abs(a - b) for row, other in zip(flange(q), by_hand_t) for a, b in zip(row, other))
            if not apart < 1e-9:
                sys.exit(f"pinocchio has the tool {apart} mm elsewhere at {q}")
    print(json.dumps({"readers": readers, "t_base_link_tool0": poses}))
