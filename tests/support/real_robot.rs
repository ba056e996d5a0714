//! A simulated robot in a cell, written without kincal's code: links with errors, joints that sag under gravity, eccentric transmissions, and an
//! instrument somewhere in the room.

#![allow(dead_code)] // each user takes its part

/// 4 × 4, row by row.
pub type Pose = [[f64; 4]; 4];

pub fn times(a: &Pose, b: &Pose) -> Pose {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

pub fn turn(axis: usize, angle: f64) -> Pose {
    let (s, c) = angle.sin_cos();
    let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut m = shift([0.0; 3]);
    (m[j][j], m[j][k], m[k][j], m[k][k]) = (c, -s, s, c);
    m
}

pub fn shift(xyz: [f64; 3]) -> Pose {
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            if i == j {
                1.0
            } else if j == 3 && i < 3 {
                xyz[i]
            } else {
                0.0
            }
        })
    })
}

pub fn apply(t: &Pose, p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| (0..3).map(|k| t[i][k] * p[k]).sum::<f64>() + t[i][3])
}

/// Rodrigues' formula, column by column.
fn about(w: [f64; 3]) -> Pose {
    let angle = w.iter().map(|x| x * x).sum::<f64>().sqrt();
    if angle == 0.0 {
        return shift([0.0; 3]);
    }
    let u = w.map(|x| x / angle);
    let (s, c) = angle.sin_cos();
    let mut m = shift([0.0; 3]);
    for column in 0..3 {
        let e: [f64; 3] = std::array::from_fn(|i| f64::from(u8::from(i == column)));
        let across = cross(u, e);
        (0..3).for_each(|i| m[i][column] = e[i] * c + across[i] * s + u[i] * u[column] * (1.0 - c));
    }
    m
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// One link: a mm, alpha rad, d mm, theta rad, beta rad.
pub type RealLink = [f64; 5];

/// The robot.
#[derive(Clone)]
pub struct RealRobot {
    pub links: Vec<RealLink>,
    /// Rotation of each joint about its axis per unit of moment (a unit of mass at a distance of one metre, under gravity), rad.
    pub give_rad: Vec<f64>,
    /// Masses at the origins of the links' frames.
    pub masses: Vec<f64>,
    /// Amplitudes of sin q, cos q, sin 2q, cos 2q added to each joint, rad.
    pub eccentric_rad: Vec<[f64; 4]>,
    /// The reflector on the flange, mm.
    pub target_mm: [f64; 3],
    /// The base in the instrument's frame, mm.
    pub t_instrument_base: Pose,
}

pub fn rigid(link: &RealLink, q: f64) -> Pose {
    let [a, alpha, d, theta, beta] = *link;
    [
        shift([a, 0.0, 0.0]),
        turn(1, beta),
        turn(2, q + theta),
        shift([0.0, 0.0, d]),
    ]
    .iter()
    .fold(turn(0, alpha), |t, part| times(&t, part))
}

impl RealRobot {
    /// The reflector in the base frame, mm.
    pub fn in_base(&self, q_rad: &[f64]) -> [f64; 3] {
        let mut rigid_frames = vec![shift([0.0; 3])];
        for (link, q) in self.links.iter().zip(q_rad) {
            rigid_frames.push(times(
                &rigid_frames[rigid_frames.len() - 1],
                &rigid(link, *q),
            ));
        }
        let mut t = shift([0.0; 3]);
        for (i, (link, q)) in self.links.iter().zip(q_rad).enumerate() {
            let [s, c, s2, c2] = self.eccentric_rad[i];
            let off = s * q.sin() + c * q.cos() + s2 * (2.0 * q).sin() + c2 * (2.0 * q).cos();
            t = times(&t, &rigid(link, q + off));
            let own = &rigid_frames[i + 1];
            let mut moment = [0.0; 3];
            for (j, mass) in self.masses.iter().enumerate().skip(i) {
                let arm_m: [f64; 3] = std::array::from_fn(|k| {
                    (rigid_frames[j + 1][k][3] - own[k][3]) / 1000.0 * mass
                });
                let of_mass = cross(arm_m, [0.0, 0.0, -1.0]);
                (0..3).for_each(|k| moment[k] += of_mass[k]);
            }
            let about_axis: f64 = (0..3).map(|k| own[k][2] * moment[k]).sum();
            t = times(&t, &about([0.0, 0.0, self.give_rad[i] * about_axis]));
        }
        apply(&t, self.target_mm)
    }

    /// The reflector in the instrument's frame, mm.
    pub fn seen(&self, q_rad: &[f64]) -> [f64; 3] {
        apply(&self.t_instrument_base, self.in_base(q_rad))
    }
}
