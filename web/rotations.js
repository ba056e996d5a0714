// How controllers and files write a rotation, and the quaternion of each.

import { el } from "./dom.js";

const RAD = Math.PI / 180;

/** How controllers write a rotation: [kind, words, names of its numbers]. */
export const ROTATIONS = [
  ["none", "not turned", []],
  ["abc", "KUKA A B C, °", ["A", "B", "C"]],
  ["wpr", "FANUC W P R, °", ["W", "P", "R"]],
  ["vector", "rotation vector (UR), rad", ["rx", "ry", "rz"]],
  ["quaternion", "quaternion w x y z (ABB q1 to q4)", ["w", "x", "y", "z"]],
];

const times = ([a, b, c, d], [w, x, y, z]) => [a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y, a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w];
const about = (axis, rad) => [Math.cos(rad / 2), ...[0, 1, 2].map((k) => (k === axis ? Math.sin(rad / 2) : 0))];

/** A rotation as a quaternion w, x, y, z. A, B, C turn about z, the new y and the new x; W, P, R about the fixed x, y and z, which is the same in reverse order. */
export function quaternion(kind, values) {
  const byZyx = ([z, y, x]) => times(times(about(2, z * RAD), about(1, y * RAD)), about(0, x * RAD));
  const byVector = (vector) => {
    const angle = Math.hypot(...vector);
    return angle === 0 ? [1, 0, 0, 0] : [Math.cos(angle / 2), ...vector.map((v) => v / angle * Math.sin(angle / 2))];
  };
  return { none: () => [1, 0, 0, 0], abc: byZyx, wpr: ([w, p, r]) => byZyx([r, p, w]), vector: byVector, quaternion: (q) => q }[kind](values);
}

/** The quaternion of a rotation matrix, w not negative: the longest row of 4·q·qᵀ, to unit length. */
export function ofMatrix([[a, b, c], [d, e, f], [g, h, i]]) {
  const rows = [[1 + a + e + i, h - f, c - g, d - b], [h - f, 1 + a - e - i, b + d, c + g], [c - g, b + d, 1 - a + e - i, f + h], [d - b, c + g, f + h, 1 - a - e + i]];
  const longest = rows.reduce((best, row, k) => (row[k] > best.size ? { row, size: row[k] } : best), { row: rows[0], size: rows[0][0] }).row;
  const by = Math.hypot(...longest) * (longest[0] < 0 ? -1 : 1);
  return longest.map((v) => v / by);
}

/** Angle between two orientations, degrees; null where a quaternion has no length. */
export function apart(a, b) {
  const [one, other] = [a, b].map((q) => Math.hypot(...q));
  if (!(one > 0 && other > 0)) return null;
  const [w, ...v] = times([a[0], -a[1], -a[2], -a[3]], b);
  return 2 * Math.atan2(Math.hypot(...v), Math.abs(w)) / RAD;
}

/** Conventions of angles that instruments and controllers write: [name in the interface, words]. */
const COMMON = [["rotation_vector", "rotation vector (UR)"], ["extrinsic_xyz", "about the fixed x, y, z (FANUC W P R; KUKA C B A)"], ["intrinsic_xyz", "about x, the new y, the new z"], ["intrinsic_zyx", "about z, the new y, the new x"], ["intrinsic_zyz", "about z, the new y, the new z"], ["extrinsic_zyx", "about the fixed z, y, x"], ["extrinsic_zyz", "about the fixed z, y, z"]];
/** Every other sequence that the service knows. */
const OTHERS = ["extrinsic", "intrinsic"].flatMap((kind) => ["xyz", "xyx", "xzx", "xzy", "yxy", "yxz", "yzx", "yzy", "zxy", "zxz", "zyx", "zyz"].map((axes) => `${kind}_${axes}`)).filter((name) => COMMON.every(([common]) => common !== name));

/** How the three angles of a file are written; a refusal names a convention as it stands here. */
export const conventionChoice = (id) => el("select", { id }, el("option", { value: "" }, "not stated"), COMMON.map(([name, words]) => el("option", { value: name }, `${name}: ${words}`)),
  el("optgroup", { label: "Other sequences: intrinsic turns about the new axes, extrinsic about the fixed ones" }, OTHERS.map((name) => el("option", { value: name }, name))));
