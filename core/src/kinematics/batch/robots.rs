//! Eight particles' robots in the form of the kernel: the fixed transforms between two commanded rotations, multiplied out.

use super::affine::{Affine, before_joint, between, store_exponential, store_untilted};
use super::lane_link::{Angle, Between, Circle, LaneLink};
use super::lanes::{InstructionSet, LANES, Lanes, Vector};
use super::sincos::{LARGEST_RAD, rotation_terms, sin_cos};
use crate::kinematics::model::Link;
use multiversion::multiversion;
use nalgebra::{IsometryMatrix3, Vector3};

/// A quantity in which particles differ from the reference. Links and targets count from 0, axes are x, y, z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moved {
    /// a of a link, mm.
    A(usize),
    /// alpha of a link, rad.
    Alpha(usize),
    /// d of a link, mm.
    D(usize),
    /// theta_offset of a link, rad.
    ThetaOffset(usize),
    /// beta of a link, rad.
    Beta(usize),
    /// The base along an axis of the measuring frame, mm.
    BaseTranslation(usize),
    /// The base's rotation vector about an axis of the measuring frame, through its origin, rad.
    BaseRotation(usize),
    /// A target along an axis of the flange frame, mm.
    Target(usize, usize),
    /// A quantity that moves no position: the rotation of a target.
    Nothing,
}

/// How the chain ends at the base.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BaseStage {
    /// Base at the measuring frame, beta_1 = 0: M_0 = Rx(alpha_1) · Dx(a_1).
    Known,
    /// Any M_0.
    Any,
    /// A single joint moves the target: its circle is already in the measuring frame.
    None,
}

/// Eight particles' robots around one reference.
#[derive(Clone, Debug)]
pub struct LaneRobots {
    reference_base: IsometryMatrix3<f64>,
    reference_links: Vec<Link>,
    reference_targets_mm: Vec<Vector3<f64>>,
    moved: Vec<Moved>,
    links: Vec<LaneLink>,
    targets_mm: Vec<[Lanes; 3]>,
    base_translation_mm: [Lanes; 3],
    base_rotation_rad: [Lanes; 3],
    /// Number of joints that move any target. If all targets are on the last axis, the last joint moves none of them.
    pub(super) n_joints: usize,
    pub(super) base_stage: BaseStage,
    /// Per target.
    pub(super) circles: Vec<Circle>,
    /// M_0 … of the joints before the circle.
    pub(super) between: Vec<Between>,
    pub(super) instructions: InstructionSet,
}

impl LaneRobots {
    /// Eight robots equal to the reference. `moved` lists the quantities that [`Self::set`] will change.
    pub fn new(
        base: &IsometryMatrix3<f64>,
        links: &[Link],
        targets_mm: &[Vector3<f64>],
        moved: &[Moved],
    ) -> Self {
        let lane_link = |link: &Link| LaneLink {
            a: Lanes::splat(link.a_mm),
            d: Lanes::splat(link.d_mm),
            alpha: Angle::reference(link.alpha_rad),
            theta: Angle::reference(link.theta_offset_rad),
            beta: Angle::reference(link.beta_rad),
        };
        let on_axis = |target: &Vector3<f64>| target.x == 0.0 && target.y == 0.0;
        let moves_off_axis = moved.iter().any(|m| matches!(m, Moved::Target(_, 0 | 1)));
        let last_turns = links.len() == 1 || moves_off_axis || !targets_mm.iter().all(on_axis);
        let n_joints = links.len() - usize::from(!last_turns);
        let base_moves = moved.iter().any(|m| {
            matches!(
                m,
                Moved::BaseTranslation(_) | Moved::BaseRotation(_) | Moved::Beta(0)
            )
        });
        let base_is_known =
            !base_moves && *base == IsometryMatrix3::identity() && links[0].beta_rad == 0.0;
        let between = Between {
            rotation: [[Lanes::ZERO; 3]; 3],
            translation: [Lanes::ZERO; 3],
            is_tilted: false,
        };
        let mut robots = Self {
            reference_base: *base,
            reference_links: links.to_vec(),
            reference_targets_mm: targets_mm.to_vec(),
            moved: moved.to_vec(),
            links: links.iter().map(lane_link).collect(),
            targets_mm: targets_mm
                .iter()
                .map(|t| [t.x, t.y, t.z].map(Lanes::splat))
                .collect(),
            base_translation_mm: [0, 1, 2].map(|axis| Lanes::splat(base.translation.vector[axis])),
            base_rotation_rad: [Lanes::ZERO; 3],
            n_joints,
            base_stage: match (n_joints, base_is_known) {
                (1, _) => BaseStage::None,
                (_, true) => BaseStage::Known,
                (_, false) => BaseStage::Any,
            },
            circles: vec![
                Circle {
                    centre: [Lanes::ZERO; 3],
                    cos: [Lanes::ZERO; 3],
                    sin: [Lanes::ZERO; 3]
                };
                targets_mm.len()
            ],
            between: vec![between; n_joints - 1],
            instructions: InstructionSet::fastest(),
        };
        for m in moved {
            robots.mark_moved(*m);
        }
        robots.set(&vec![Lanes::ZERO; moved.len()]);
        robots
    }

    /// Number of links.
    pub(super) fn n_links(&self) -> usize {
        self.links.len()
    }

    /// Selects another code path; the results are the same to the last bit.
    pub fn with_instructions(mut self, instructions: InstructionSet) -> Self {
        self.instructions = instructions;
        self
    }

    /// Changes the robots: one deviation from the reference per entry of `moved`, in its order.
    ///
    /// # Panics
    /// When there are fewer or more.
    pub fn set(&mut self, deviations: &[Lanes]) {
        assert_eq!(
            deviations.len(),
            self.moved.len(),
            "one deviation per moved quantity"
        );
        match self.instructions {
            InstructionSet::Avx512 => set_on_avx512(self, deviations),
            InstructionSet::Avx2 => set_on_avx2(self, deviations),
            InstructionSet::Baseline => self.set_with::<2>(deviations),
        }
    }

    /// Copies one robot of `from` to a lane, as far as the kernel uses it.
    #[inline]
    pub(super) fn copy_lane(&mut self, lane: usize, from: &Self, from_lane: usize) {
        let (lane, from_lane) = (lane % LANES, from_lane % LANES);
        let copy = |to: &mut [Lanes; 3], from: &[Lanes; 3]| {
            for (to, from) in to.iter_mut().zip(from) {
                to.0[lane] = from.0[from_lane];
            }
        };
        for (to, from) in self.circles.iter_mut().zip(&from.circles) {
            copy(&mut to.centre, &from.centre);
            copy(&mut to.cos, &from.cos);
            copy(&mut to.sin, &from.sin);
        }
        for (to, from) in self.between.iter_mut().zip(&from.between) {
            to.is_tilted = from.is_tilted;
            copy(&mut to.translation, &from.translation);
            for (to, from) in to.rotation.iter_mut().zip(&from.rotation) {
                copy(to, from);
            }
        }
    }

    fn mark_moved(&mut self, moved: Moved) {
        match moved {
            Moved::Alpha(link) => self.links[link].alpha.is_moved = true,
            Moved::ThetaOffset(link) => self.links[link].theta.is_moved = true,
            Moved::Beta(link) => self.links[link].beta.is_moved = true,
            _ => {}
        }
    }

    /// Stores the deviations in the quantities that they belong to.
    #[inline(always)]
    fn place<const W: usize>(&mut self, deviations: &[Lanes]) {
        for (moved, deviation) in self.moved.iter().zip(deviations) {
            match *moved {
                Moved::A(link) => add::<W>(
                    self.reference_links[link].a_mm,
                    deviation,
                    &mut self.links[link].a,
                ),
                Moved::D(link) => add::<W>(
                    self.reference_links[link].d_mm,
                    deviation,
                    &mut self.links[link].d,
                ),
                Moved::Alpha(link) => self.links[link].alpha.deviation_rad = *deviation,
                Moved::ThetaOffset(link) => self.links[link].theta.deviation_rad = *deviation,
                Moved::Beta(link) => self.links[link].beta.deviation_rad = *deviation,
                Moved::BaseTranslation(axis) => {
                    add::<W>(
                        self.reference_base.translation.vector[axis],
                        deviation,
                        &mut self.base_translation_mm[axis],
                    );
                }
                Moved::BaseRotation(axis) => self.base_rotation_rad[axis] = *deviation,
                Moved::Target(target, axis) => {
                    add::<W>(
                        self.reference_targets_mm[target][axis],
                        deviation,
                        &mut self.targets_mm[target][axis],
                    );
                }
                Moved::Nothing => {}
            }
        }
    }
}

/// to <- reference + deviation.
#[inline(always)]
fn add<const W: usize>(reference: f64, deviation: &Lanes, to: &mut Lanes) {
    for part in 0..Vector::<W>::PER_CHUNK {
        (Vector::<W>::splat(reference) + Vector::load(deviation, part)).store(to, part);
    }
}

impl Angle {
    fn reference(reference_rad: f64) -> Self {
        let (sin, cos) = libm::sincos(reference_rad);
        let still = Lanes::ZERO;
        Self {
            reference: (sin, cos),
            deviation_rad: still,
            is_moved: false,
            sin: Lanes::splat(sin),
            cos: Lanes::splat(cos),
        }
    }

    /// Sine and cosine of reference + deviation, by the addition theorems.
    #[inline(always)]
    fn refresh<const W: usize>(&mut self, all_are_small: bool) {
        if !self.is_moved {
            return;
        }
        let (reference_sin, reference_cos) = (
            Vector::<W>::splat(self.reference.0),
            Vector::<W>::splat(self.reference.1),
        );
        for part in 0..Vector::<W>::PER_CHUNK {
            let (s, c) = sin_cos(Vector::<W>::load(&self.deviation_rad, part));
            reference_sin
                .mul_add(c, reference_cos * s)
                .store(&mut self.sin, part);
            reference_cos
                .mul_add(c, -(reference_sin * s))
                .store(&mut self.cos, part);
        }
        if !all_are_small {
            self.refresh_large();
        }
    }

    /// As [`Self::refresh`], for the lanes in which the polynomials are not accurate.
    #[cold]
    fn refresh_large(&mut self) {
        for lane in (0..LANES).filter(|lane| self.deviation_rad.0[*lane].abs() > LARGEST_RAD) {
            let (s, c) = libm::sincos(self.deviation_rad.0[lane]);
            self.sin.0[lane] = self.reference.0.mul_add(c, self.reference.1 * s);
            self.cos.0[lane] = self.reference.1.mul_add(c, -(self.reference.0 * s));
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+fma"))]
fn set_on_avx512(robots: &mut LaneRobots, deviations: &[Lanes]) {
    robots.set_with::<8>(deviations);
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn set_on_avx2(robots: &mut LaneRobots, deviations: &[Lanes]) {
    robots.set_with::<4>(deviations);
}

impl LaneRobots {
    #[inline(always)]
    fn set_with<const W: usize>(&mut self, deviations: &[Lanes]) {
        self.place::<W>(deviations);
        self.refresh::<W>();
    }

    /// Computes circles and M from lengths and angles.
    #[inline(always)]
    fn refresh<const W: usize>(&mut self) {
        let all_are_small = self.angles_are_small();
        for link in &mut self.links {
            link.alpha.refresh::<W>(all_are_small);
            link.theta.refresh::<W>(all_are_small);
            link.beta.refresh::<W>(all_are_small);
        }
        let mut base = [[Lanes::ZERO; 3]; 3];
        if self.base_stage != BaseStage::Known {
            self.base_rotation::<W>(&mut base);
        }
        for part in 0..Vector::<W>::PER_CHUNK {
            self.refresh_part::<W>(&base, part);
        }
    }

    #[inline(always)]
    fn refresh_part<const W: usize>(&mut self, base: &[[Lanes; 3]; 3], part: usize) {
        let n = self.between.len();
        if n > 0 {
            self.first::<W>(base, part)
                .store(&mut self.between[0], part);
            self.between[0].is_tilted = true;
        }
        for i in 1..n {
            let (link, next) = (&self.links[i - 1], &self.links[i]);
            self.between[i].is_tilted = next.has_beta();
            if next.has_beta() {
                between::<W>(link, next, part).store(&mut self.between[i], part);
            } else {
                store_untilted::<W>(link, next, &mut self.between[i], part);
            }
        }
        let behind = if n > 0 {
            between(&self.links[n - 1], &self.links[n], part)
        } else {
            self.first::<W>(base, part)
        };
        for target in 0..self.targets_mm.len() {
            let point = self.turned_point(&self.targets_mm[target], part);
            behind.store_circle(point, &mut self.circles[target], part);
        }
    }

    /// True if the polynomials are accurate for all deviations of all lanes.
    #[inline(always)]
    fn angles_are_small(&self) -> bool {
        let mut largest = [0.0; LANES];
        for link in &self.links {
            for angle in [&link.alpha, &link.theta, &link.beta]
                .into_iter()
                .filter(|angle| angle.is_moved)
            {
                for (largest, deviation) in largest.iter_mut().zip(&angle.deviation_rad.0) {
                    *largest = if deviation.abs() > *largest {
                        deviation.abs()
                    } else {
                        *largest
                    };
                }
            }
        }
        largest.iter().all(|largest| *largest <= LARGEST_RAD)
    }

    /// M_0 = base · Rx(alpha_1) · Dx(a_1) · Ry(beta_1).
    #[inline(always)]
    fn first<const W: usize>(&self, base: &[[Lanes; 3]; 3], part: usize) -> Affine<W> {
        let mut first = before_joint(&self.links[0], part);
        if self.base_stage == BaseStage::Known {
            return first;
        }
        let Affine {
            rotation: [x, y, z],
            translation: [a, ..],
        } = first;
        for (row, base) in base.iter().enumerate() {
            let [r0, r1, r2] = Vector::<W>::load_all(base, part);
            for column in 0..3 {
                first.rotation[row][column] =
                    r0.mul_add(x[column], r1.mul_add(y[column], r2 * z[column]));
            }
            first.translation[row] =
                r0.mul_add(a, Vector::load(&self.base_translation_mm[row], part));
        }
        first
    }

    /// The target in the frame of the last joint that moves it: M_n, or M_{n-1} · Dz(d_n) · target if the last joint moves nothing.
    #[inline(always)]
    fn turned_point<const W: usize>(&self, target: &[Lanes; 3], part: usize) -> [Vector<W>; 3] {
        let last = self.links.len() - 1;
        let link = &self.links[last];
        let [x, y, z] = Vector::<W>::load_all(target, part);
        let z = z + Vector::load(&link.d, part);
        if self.n_joints == self.links.len() {
            let (s, c) = (
                Vector::<W>::load(&link.theta.sin, part),
                Vector::<W>::load(&link.theta.cos, part),
            );
            return [c.mul_add(x, -(s * y)), s.mul_add(x, c * y), z];
        }
        let Affine {
            rotation: [row_x, row_y, row_z],
            translation: [tx, ty, tz],
        } = between(&self.links[last - 1], link, part);
        [
            row_x[2].mul_add(z, tx),
            row_y[2].mul_add(z, ty),
            row_z[2].mul_add(z, tz),
        ]
    }

    /// Exp(w) · (the reference's rotation), by Rodrigues' formula.
    #[inline(always)]
    fn base_rotation<const W: usize>(&self, rotation: &mut [[Lanes; 3]; 3]) {
        let (sine, versine) = rotation_terms::<W>(&self.base_rotation_rad);
        store_exponential(
            &self.base_rotation_rad,
            &sine,
            &versine,
            self.reference_base.rotation.matrix(),
            rotation,
        );
    }
}

impl LaneLink {
    #[inline(always)]
    pub fn has_beta(&self) -> bool {
        self.beta.is_moved || self.beta.reference.0 != 0.0
    }
}
