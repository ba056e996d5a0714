// How far two parameter sets put the same tool apart: what a robot's drift is measured by here.

const POSES = 60;
const RADIANS = Math.PI / 180;

/** 4x4 row-major product. */
function times(a, b) {
  const c = new Array(16).fill(0);
  for (let i = 0; i < 4; i += 1) for (let j = 0; j < 4; j += 1) for (let k = 0; k < 4; k += 1) c[4 * i + j] += a[4 * i + k] * b[4 * k + j];
  return c;
}

const shift = (x, y, z) => [1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1];
const turnX = (t) => [1, 0, 0, 0, 0, Math.cos(t), -Math.sin(t), 0, 0, Math.sin(t), Math.cos(t), 0, 0, 0, 0, 1];
const turnY = (t) => [Math.cos(t), 0, Math.sin(t), 0, 0, 1, 0, 0, -Math.sin(t), 0, Math.cos(t), 0, 0, 0, 0, 1];
const turnZ = (t) => [Math.cos(t), -Math.sin(t), 0, 0, Math.sin(t), Math.cos(t), 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

/** Position of a target in the base frame, mm: the product over links of Rx(alpha) · Dx(a) · Ry(beta) · Rz(q + theta_offset) · Dz(d). */
export function position(links, qDeg, target = [0, 0, 0]) {
  let t = shift(0, 0, 0);
  links.forEach((link, i) => {
    const steps = [turnX(link.alpha_deg * RADIANS), shift(link.a_mm, 0, 0), turnY((link.beta_deg ?? 0) * RADIANS), turnZ((qDeg[i] + (link.theta_offset_deg ?? 0)) * RADIANS), shift(0, 0, link.d_mm)];
    for (const step of steps) t = times(t, step);
  });
  return [0, 1, 2].map((i) => t[4 * i] * target[0] + t[4 * i + 1] * target[1] + t[4 * i + 2] * target[2] + t[4 * i + 3]);
}

/** The same poses each time: a golden-ratio sequence within the joint limits, else within ±60 degrees. */
function poses(robot) {
  return Array.from({ length: POSES }, (_, n) => robot.links.map((link, i) => {
    const [low, high] = link.joint_limits_deg ?? [-60, 60];
    const share = ((n + 1) * (0.618034 + 0.1373 * i)) % 1;
    return low + share * (high - low);
  }));
}

/** Mean distance between the tool positions of two parameter sets, mm, over the robot's workspace. */
export function drift(robot, one, other) {
  const target = one.targets?.[0]?.position_mm ?? [0, 0, 0];
  const apart = poses(robot).map((q) => {
    const [a, b] = [position(one.links, q, target), position(other.links, q, target)];
    return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
  });
  return apart.reduce((sum, d) => sum + d, 0) / apart.length;
}
