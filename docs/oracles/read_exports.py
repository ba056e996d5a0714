"""Reads a parameter set's exports with other people's tools (numpy, PyYAML, ElementTree) and moves them side by side.

    for f in json yaml csv urdf ur_kinematics; do curl -s "$SERVER/v1/parameter-sets/$ID/export?format=$f" > set.$f; done
    python docs/oracles/read_exports.py set.json set.yaml set.csv set.urdf set.ur_kinematics

Prints the largest difference of the flange from the JSON's links over 200 random configurations, mm, and rad of its rotation.
"""

import csv
import json
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import yaml


def turn(axis, angle):
    m = np.eye(4)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(angle), np.sin(angle)
    m[j, j], m[j, k], m[k, j], m[k, k] = c, -s, s, c
    return m


def shift(x, y, z):
    m = np.eye(4)
    m[:3, 3] = x, y, z
    return m


def by_links(links):
    def flange(q):
        t = np.eye(4)
        for link, value in zip(links, q):
            rad = {name: np.radians(float(link[name])) for name in ("alpha_deg", "beta_deg", "theta_offset_deg")}
            t = t @ turn(0, rad["alpha_deg"]) @ shift(float(link["a_mm"]), 0, 0) @ turn(1, rad["beta_deg"])
            t = t @ turn(2, value + rad["theta_offset_deg"]) @ shift(0, 0, float(link["d_mm"]))
        return t

    return flange


def origin(xyz_m, rpy):
    return shift(*(1e3 * np.array(xyz_m))) @ turn(2, rpy[2]) @ turn(1, rpy[1]) @ turn(0, rpy[0])


def by_urdf(path):
    joints = {}
    for joint in ElementTree.parse(path).getroot().findall("joint"):
        joints[joint.find("parent").get("link"), joint.get("type") == "fixed"] = joint
    link, chain = "base_link", []
    while (link, False) in joints:
        joint = joints[link, False]
        numbers = lambda tag, name: [float(v) for v in joint.find(tag).get(name).split()]
        chain.append((origin(numbers("origin", "xyz"), numbers("origin", "rpy")), numbers("axis", "xyz")))
        link = joint.find("child").get("link")

    def flange(q):
        t = np.eye(4)
        for (pose, axis), value in zip(chain, q):
            t = t @ pose @ turn(2, axis[2] * value)
        return t

    return flange


def by_ur(path):
    frames = yaml.safe_load(open(path))["kinematics"]
    names = ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]
    poses = [origin([frames[n][k] for k in "xyz"], [frames[n][k] for k in ("roll", "pitch", "yaw")]) for n in names]

    def flange(q):
        t = np.eye(4)
        for pose, value in zip(poses, q):
            t = t @ pose @ turn(2, value)
        return t

    return flange


def reader(path):
    kind = path.rsplit(".", 1)[1]
    if kind == "json":
        return by_links(json.load(open(path))["links"])
    if kind == "yaml":
        return by_links(yaml.safe_load(open(path))["links"])
    if kind == "csv":
        return by_links(list(csv.DictReader(open(path))))
    return by_urdf(path) if kind == "urdf" else by_ur(path)


if __name__ == "__main__":
    meant, *others = [(path, reader(path)) for path in sys.argv[1:]]
    n = len(json.load(open(meant[0]))["links"])
    configurations = np.random.default_rng(0).uniform(-np.pi, np.pi, (200, n))
    for path, flange in others:
        apart = [flange(q) - meant[1](q) for q in configurations]
        mm = max(np.linalg.norm(a[:3, 3]) for a in apart)
        print(f"{path:20} {mm:.1e} mm  {max(abs(a[:3, :3]).max() for a in apart):.1e} rad")
