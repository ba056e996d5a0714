//! The fast cost kernel: F of eight particles at once over all poses, no trigonometry in the inner loop.
//!
//! `forward.rs` is its oracle. Lanes hold particles, so each particle's sum runs in pose order whatever the vector
//! width, and products are added with an explicit fused multiply-add: the bits are the same on every CPU.

use crate::kinematics::model::Link;
use nalgebra::{IsometryMatrix3, Vector3};

/// Particles per chunk; fixed, so that nothing depends on the machine's vector width.
pub const LANES: usize = 8;
/// One value for each of the eight particles.
pub type Lanes = [f64; LANES];

/// The measured poses, prepared once per job.
#[derive(Clone, Debug, PartialEq)]
pub struct PreparedPoses {
    /// (cos q, sin q) of the commanded joints, `[pose][link]`.
    cos_sin_q: Vec<(f64, f64)>,
    /// Measured positions, mm.
    measured_mm: Vec<Vector3<f64>>,
    /// Weight of each squared residual.
    weight: Vec<f64>,
    /// Target index of each pose.
    target: Vec<usize>,
    n_links: usize,
}

impl PreparedPoses {
    /// Room for poses of a robot with `n_links` links.
    pub fn new(n_links: usize) -> Self {
        Self { cos_sin_q: Vec::new(), measured_mm: Vec::new(), weight: Vec::new(), target: Vec::new(), n_links }
    }

    /// Adds one pose: joint values (rad), the measured position (mm), the weight of its squared residual.
    pub fn push(&mut self, q_rad: &[f64], measured_mm: Vector3<f64>, weight: f64, target: usize) {
        assert_eq!(q_rad.len(), self.n_links, "one joint value per link");
        self.cos_sin_q.extend(q_rad.iter().map(|q| (libm::cos(*q), libm::sin(*q))));
        self.measured_mm.push(measured_mm);
        self.weight.push(weight);
        self.target.push(target);
    }
}

/// One link of eight particles: lengths, and the cosines and sines of its constant angles.
#[derive(Clone, Copy, Debug)]
struct LaneLink {
    a: Lanes,
    d: Lanes,
    cos_alpha: Lanes,
    sin_alpha: Lanes,
    cos_theta: Lanes,
    sin_theta: Lanes,
    cos_beta: Lanes,
    sin_beta: Lanes,
    has_beta: bool,
}

/// Eight particles' robots: links, targets and base pose, lane by lane.
#[derive(Clone, Debug)]
pub struct LaneRobots {
    links: Vec<LaneLink>,
    targets: Vec<[Lanes; 3]>,
    /// Rotation of the base, row-major, and its translation.
    base_rotation: [[Lanes; 3]; 3],
    base_translation: [Lanes; 3],
    base_is_identity: bool,
}

impl LaneRobots {
    /// Room for robots of `n_links` links and `n_targets` targets.
    pub fn new(n_links: usize, n_targets: usize) -> Self {
        let zero = [0.0; LANES];
        let link = LaneLink {
            a: zero,
            d: zero,
            cos_alpha: zero,
            sin_alpha: zero,
            cos_theta: zero,
            sin_theta: zero,
            cos_beta: zero,
            sin_beta: zero,
            has_beta: false,
        };
        Self {
            links: vec![link; n_links],
            targets: vec![[zero; 3]; n_targets],
            base_rotation: [[zero; 3]; 3],
            base_translation: [zero; 3],
            base_is_identity: true,
        }
    }

    /// Forgets which terms were needed; call before the eight [`Self::set_lane`] of a chunk.
    pub fn clear(&mut self) {
        self.base_is_identity = true;
        self.links.iter_mut().for_each(|link| link.has_beta = false);
    }

    /// Puts one particle's robot into `lane`.
    pub fn set_lane(&mut self, lane: usize, links: &[Link], base: &IsometryMatrix3<f64>, targets_mm: &[Vector3<f64>]) {
        for (to, link) in self.links.iter_mut().zip(links) {
            to.a[lane] = link.a_mm;
            to.d[lane] = link.d_mm;
            (to.sin_alpha[lane], to.cos_alpha[lane]) = libm::sincos(link.alpha_rad);
            (to.sin_theta[lane], to.cos_theta[lane]) = libm::sincos(link.theta_offset_rad);
            (to.sin_beta[lane], to.cos_beta[lane]) = libm::sincos(link.beta_rad);
            to.has_beta |= link.beta_rad != 0.0;
        }
        for (to, target) in self.targets.iter_mut().zip(targets_mm) {
            for axis in 0..3 {
                to[axis][lane] = target[axis];
            }
        }
        for row in 0..3 {
            for column in 0..3 {
                self.base_rotation[row][column][lane] = base.rotation.matrix()[(row, column)];
            }
            self.base_translation[row][lane] = base.translation.vector[row];
        }
        self.base_is_identity &= *base == IsometryMatrix3::identity();
    }
}

/// F = Σ weight · |measured − predicted|² of eight particles [Gao 2018, eq. 8, 11], mm².
///
/// The target is pushed back through the chain, last link first: Dz(d), Rz(q + theta_offset), Ry(beta), Dx(a), Rx(alpha).
#[multiversion::multiversion(targets("x86_64+avx512f+avx512vl+fma", "x86_64+avx2+fma", "aarch64+neon"))]
pub fn sum_of_squares(robots: &LaneRobots, poses: &PreparedPoses) -> Lanes {
    let mut sum = [0.0; LANES];
    let n_links = poses.n_links;
    for pose in 0..poses.measured_mm.len() {
        let cos_sin_q = &poses.cos_sin_q[pose * n_links..(pose + 1) * n_links];
        let [mut x, mut y, mut z] = robots.targets[poses.target[pose]];
        for (link, cos_sin) in robots.links.iter().zip(cos_sin_q).rev() {
            push_through_link(link, *cos_sin, &mut x, &mut y, &mut z);
        }
        add_squared_residual(robots, &poses.measured_mm[pose], poses.weight[pose], &x, &y, &z, &mut sum);
    }
    sum
}

/// One link back: the point in link frame i becomes the point in link frame i-1.
#[inline(always)]
fn push_through_link(link: &LaneLink, (cos_q, sin_q): (f64, f64), x: &mut Lanes, y: &mut Lanes, z: &mut Lanes) {
    for l in 0..LANES {
        // cos and sin of q + theta_offset by the addition theorems
        let c = cos_q.mul_add(link.cos_theta[l], -(sin_q * link.sin_theta[l]));
        let s = sin_q.mul_add(link.cos_theta[l], cos_q * link.sin_theta[l]);
        z[l] += link.d[l];
        let u = c.mul_add(x[l], -(s * y[l]));
        y[l] = s.mul_add(x[l], c * y[l]);
        x[l] = u;
    }
    if link.has_beta {
        for l in 0..LANES {
            let u = link.cos_beta[l].mul_add(x[l], link.sin_beta[l] * z[l]);
            z[l] = link.cos_beta[l].mul_add(z[l], -(link.sin_beta[l] * x[l]));
            x[l] = u;
        }
    }
    for l in 0..LANES {
        x[l] += link.a[l];
        let v = link.cos_alpha[l].mul_add(y[l], -(link.sin_alpha[l] * z[l]));
        z[l] = link.sin_alpha[l].mul_add(y[l], link.cos_alpha[l] * z[l]);
        y[l] = v;
    }
}

/// Base pose, residual = measured − predicted, and its weighted square onto the sum.
#[inline(always)]
fn add_squared_residual(robots: &LaneRobots, measured: &Vector3<f64>, weight: f64, x: &Lanes, y: &Lanes, z: &Lanes, sum: &mut Lanes) {
    for l in 0..LANES {
        let mut square = 0.0f64;
        for row in 0..3 {
            let predicted = if robots.base_is_identity {
                [x[l], y[l], z[l]][row]
            } else {
                let r = &robots.base_rotation[row];
                r[0][l].mul_add(x[l], r[1][l].mul_add(y[l], r[2][l].mul_add(z[l], robots.base_translation[row][l])))
            };
            let residual = measured[row] - predicted;
            square = residual.mul_add(residual, square);
        }
        sum[l] = weight.mul_add(square, sum[l]);
    }
}
