// Forward kinematics of the nominal and of the identified robot, as core/src/kinematics/forward.rs has it. Poses are arrays of 12 numbers: three
// rows of rotation and translation. Lengths in mm.

const RAD = Math.PI / 180;

export const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];

/** a · b. */
export function compose(a, b) {
  const out = new Array(12);
  for (let r = 0; r < 12; r += 4) {
    for (let c = 0; c < 4; c += 1) out[r + c] = a[r] * b[c] + a[r + 1] * b[4 + c] + a[r + 2] * b[8 + c] + (c === 3 ? a[r + 3] : 0);
  }
  return out;
}

/** A point of the pose's frame in the frame that the pose stands in. */
export const apply = (t, [x, y, z]) => [t[0] * x + t[1] * y + t[2] * z + t[3], t[4] * x + t[5] * y + t[6] * z + t[7], t[8] * x + t[9] * y + t[10] * z + t[11]];
/** A direction, likewise. */
export const turn = (t, [x, y, z]) => [t[0] * x + t[1] * y + t[2] * z, t[4] * x + t[5] * y + t[6] * z, t[8] * x + t[9] * y + t[10] * z];
/** The pose the other way round. */
export function inverse(t) {
  const back = [t[0], t[4], t[8], 0, t[1], t[5], t[9], 0, t[2], t[6], t[10], 0];
  const moved = turn(back, [t[3], t[7], t[11]]);
  return back.map((v, i) => (i % 4 === 3 ? -moved[(i - 3) / 4] : v));
}
export const origin = (t) => [t[3], t[7], t[11]];
export const axisX = (t) => [t[0], t[4], t[8]];
export const axisZ = (t) => [t[2], t[6], t[10]];

/** The service's `{rotation, translation_mm}` as a pose. */
export const poseOf = ({ rotation: r, translation_mm: p }) => [0, 1, 2].flatMap((i) => [...r[i], p[i]]);

/** The model's joint values, rad, from those of the controller, degrees: coupling · (sign ∘ q) + offset. */
export function modelJoints(robot, q) {
  const { sign, offset_deg: offset, coupling } = robot.joint_map ?? {};
  const turned = q.map((v, i) => v * (sign?.[i] ?? 1));
  const coupled = coupling ? coupling.map((row) => row.reduce((sum, c, i) => sum + c * turned[i], 0)) : turned;
  return coupled.map((v, i) => (v + (offset?.[i] ?? 0)) * RAD);
}

/** Link frame in the one before it: Rx(alpha) · Dx(a) · Ry(beta) · Rz(q + theta_offset) · Dz(d). */
export function linkPose(link, q) {
  const theta = (link.theta_offset_deg ?? 0) * RAD + q;
  const d = link.d_mm;
  const [alpha, beta] = [link.alpha_deg * RAD, (link.beta_deg ?? 0) * RAD];
  const [ca, sa, cb, sb, ct, st] = [Math.cos(alpha), Math.sin(alpha), Math.cos(beta), Math.sin(beta), Math.cos(theta), Math.sin(theta)];
  const rx = [1, 0, 0, 0, 0, ca, -sa, 0, 0, sa, ca, 0];
  const rest = [cb * ct, -cb * st, sb, link.a_mm + sb * d, st, ct, 0, 0, -sb * ct, sb * st, cb, cb * d];
  return compose(rx, rest);
}

/** Base, each link, and the flange at last, in the base frame. `q` are the controller's joint values. */
export function framesOf(robot, q) {
  const values = modelJoints(robot, q);
  const frames = [IDENTITY];
  robot.links.forEach((link, i) => frames.push(compose(frames[i], linkPose(link, values[i]))));
  return frames;
}

/** A point of the flange frame in the base frame. */
export const positionOf = (robot, q, target = [0, 0, 0]) => apply(framesOf(robot, q).at(-1), target);

/** Distance from joint to joint, summed: no point of the arm is further from its base. */
export const reachOf = (robot) => robot.links.reduce((sum, link) => sum + Math.hypot(link.a_mm, link.d_mm), 0) || 1;

/** Joint values at which the arm is drawn where nothing else is said: the middle of each joint's limits, if 0 is outside of them. */
export function restOf(robot) {
  return robot.links.map(({ joint_limits_deg: limits }) => {
    const [low, high] = limits ?? [-Infinity, Infinity];
    return low <= 0 && high >= 0 ? 0 : (low + high) / 2;
  });
}

/** Iterations that find the rotation; points that are not in a line need far fewer. */
const PLACEMENT_STEPS = 400;

/** The rigid motion that brings points onto others best in the sum of squares. Horn (1987), "Closed-form solution of absolute orientation using unit quaternions", section 4. */
export function placement(from, to) {
  const mean = (points) => [0, 1, 2].map((k) => points.reduce((sum, p) => sum + p[k], 0) / points.length);
  const [a, b] = [mean(from), mean(to)];
  const s = [0, 1, 2].map((i) => [0, 1, 2].map((j) => from.reduce((sum, p, n) => sum + (p[i] - a[i]) * (to[n][j] - b[j]), 0)));
  const n = [[s[0][0] + s[1][1] + s[2][2], s[1][2] - s[2][1], s[2][0] - s[0][2], s[0][1] - s[1][0]], [0, s[0][0] - s[1][1] - s[2][2], s[0][1] + s[1][0], s[2][0] + s[0][2]],
    [0, 0, s[1][1] - s[0][0] - s[2][2], s[1][2] + s[2][1]], [0, 0, 0, s[2][2] - s[0][0] - s[1][1]]];
  for (let i = 0; i < 4; i += 1) for (let j = 0; j < i; j += 1) n[i][j] = n[j][i];
  // the eigenvector of the largest eigenvalue, by powers; the shift makes every eigenvalue positive
  const shift = Math.hypot(...n.flat());
  let q = [1, 0.1, 0.2, 0.3];
  for (let step = 0; step < PLACEMENT_STEPS; step += 1) {
    const next = n.map((row, i) => shift * q[i] + row.reduce((sum, v, j) => sum + v * q[j], 0));
    const length = Math.hypot(...next) || 1;
    q = next.map((v) => v / length);
  }
  const [w, x, y, z] = q;
  const turned = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 0, 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), 0, 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), 0];
  const moved = turn(turned, a);
  return turned.map((v, i) => (i % 4 === 3 ? b[(i - 3) / 4] - moved[(i - 3) / 4] : v));
}

/** Random numbers from 0 to 1, the same each time, so that pictures can be compared. */
export function randomNumbers() {
  let state = 1;
  // Lehmer's generator; 48271 and 2³¹ − 1 are those of Park and Miller
  return () => { state = (state * 48271) % 2147483647; return state / 2147483647; };
}
