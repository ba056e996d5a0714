//! A lower bound of F for eight particles in a tenth of the time of F. A particle whose bound exceeds its own best cost needs no F.
//!
//! Let r be all residuals times the roots of their weights, so that F = ‖r‖². Let δ be a particle's deviations from an anchor, where r is r₀ and its
//! derivative is J. With r(δ) = r₀ + J·δ + e and J = Q·R,
//!
//! ```text
//! sqrt(F) >= ‖r₀ + J·δ‖ − ‖e‖,  ‖r₀ + J·δ‖² = ‖c + R·δ‖² + ‖b‖²          (c, b) = Qᵀ·r₀
//! ```
//!
//! **Upper bound of e.** On the path from the anchor to the particle, δ(t) = t·δ, Taylor's formula with an integral remainder gives ‖e‖ ≤
//! ½·max‖r″(t)‖. Let the quantities be numbered from the base to the target. The position p is a product of elementary motions, and a quantity nearer
//! to the base moves everything after it. For i before j, or i = j,
//!
//! ```text
//! ∂²p/∂δᵢ∂δⱼ = axisᵢ × ∂p/∂δⱼ      if i is an angle, and 0 if it is a length
//! ‖r″‖ <= Σⱼ |δⱼ|·mⱼ·(|δⱼ| if j is an angle  +  2·Σ |δᵢ| over the angles i before j)
//! ```
//!
//! with mⱼ an upper bound of ‖∂r/∂δⱼ‖ on the path. For a length, this norm is constant. For an angle, it is the target's distance from the axis, over
//! all poses. This distance changes by no more than the target moves relative to the axis, and only quantities after the axis move it there: mⱼ =
//! ‖∂r/∂δⱼ‖ at the anchor + Σ |δₖ|·mₖ over k after j. (Sums over poses by Minkowski's inequality.) One sweep from the target to the base computes all
//! of these sums.
//!
//! The base's rotation vector w counts as one angle |w|. Along w + t·δ the base rotates at ω = J(w)·δ, |ω| ≤ |δ| and |ω′| ≤ ½·|δ|², for J(w) = ∫
//! Exp(s·w) ds. Its own second derivative is therefore at most 3/2·|δ|² times the target's distance from the base's origin.
//!
//! The bound also holds for large deviations: they give a large e, and the bound is then useless, but not wrong. It does not require exact
//! arithmetic: see [`Anchored::rounding`]. NaN exceeds nothing.

use super::lanes::{InstructionSet, LANES, Lanes, Vector};
use super::robots::Moved;
use multiversion::multiversion;

/// Number of rows of R that are summed side by side.
const ROWS: usize = 4;

/// The lower bound around one anchor.
#[derive(Clone, Debug)]
pub struct LowerBound {
    /// Links' and targets' quantities, from the target to the base.
    chain: Vec<Quantity>,
    base_rotation: Vec<Quantity>,
    base_translation: Vec<Quantity>,
    base_arm_mm: f64,
    /// c, padded with zeros to a multiple of [`ROWS`].
    constant: Vec<f64>,
    /// ‖b‖², which no deviation changes, mm².
    apart_mm2: f64,
    /// R in panels of [`ROWS`] rows. Each panel has the columns from its first row's diagonal on.
    panels: Vec<[f64; ROWS]>,
    rounding: f64,
    size_mm: f64,
    instructions: InstructionSet,
}

/// A quantity in which robots differ.
#[derive(Clone, Copy, Debug)]
struct Quantity {
    /// Its index among the deviations.
    at: usize,
    /// Its value at the anchor, mm or rad.
    anchor: f64,
    /// 1 for an angle, 0 for a length.
    turns: f64,
    /// ‖∂r/∂δ‖ at the anchor, mm per mm or rad.
    effect_mm: f64,
}

impl Quantity {
    /// The deviation from the anchor. It is also stored in `deltas`.
    #[inline(always)]
    fn delta<const W: usize>(
        &self,
        deviations: &[Lanes],
        deltas: &mut [Lanes],
        part: usize,
    ) -> Vector<W> {
        let delta = Vector::load(&deviations[self.at], part) - Vector::splat(self.anchor);
        delta.store(&mut deltas[self.at], part);
        delta
    }
}

/// The linearisation at an anchor.
#[derive(Clone, Copy, Debug)]
pub struct Anchored<'a> {
    /// Deviations of the anchor from the reference, mm or rad.
    pub deviation: &'a [f64],
    /// Norm of each column of J, mm per mm or rad.
    pub effects_mm: &'a [f64],
    /// R in the upper triangle of a column-major matrix.
    pub triangle: &'a [f64],
    /// Rows of that matrix.
    pub n_rows: usize,
    /// Qᵀ·r₀: c in its first entries, b in the others.
    pub qt_residuals: &'a [f64],
    /// Root of Σ weight · (distance of the target from the base's origin)², mm, or an upper bound of it.
    pub base_arm_mm: f64,
    /// The bound is lowered by this share of the sizes that are added: many times their rounding errors, here and in F.
    pub rounding: f64,
    /// An upper bound of these sizes at the anchor, over all poses: residuals, measured positions, lengths, mm. The bound itself adds the effect of
    /// deviations on them.
    pub size_mm: f64,
}

impl LowerBound {
    /// Allocates the bound for robots that differ in these quantities. Without an anchor it exceeds nothing.
    pub fn new(moved: &[Moved]) -> Self {
        let p = moved.len();
        let quantity = |at: usize| {
            let is_angle = matches!(
                moved[at],
                Moved::Alpha(_) | Moved::Beta(_) | Moved::ThetaOffset(_)
            );
            Quantity {
                at,
                anchor: 0.0,
                turns: f64::from(u8::from(is_angle)),
                effect_mm: 0.0,
            }
        };
        let those = |wanted: fn(&Moved) -> bool| {
            (0..p)
                .filter(|at| wanted(&moved[*at]))
                .map(quantity)
                .collect()
        };
        let mut chain: Vec<Quantity> = those(|m| place(m).is_some());
        chain.sort_by_key(|quantity| std::cmp::Reverse(place(&moved[quantity.at])));
        Self {
            chain,
            base_rotation: those(|m| matches!(m, Moved::BaseRotation(_))),
            base_translation: those(|m| matches!(m, Moved::BaseTranslation(_))),
            base_arm_mm: 0.0,
            constant: vec![0.0; p.next_multiple_of(ROWS)],
            apart_mm2: 0.0,
            panels: (0..p)
                .step_by(ROWS)
                .flat_map(|first| first..p)
                .map(|_| [0.0; ROWS])
                .collect(),
            rounding: f64::INFINITY,
            size_mm: f64::INFINITY,
            instructions: InstructionSet::fastest(),
        }
    }

    /// Selects another code path.
    pub fn with_instructions(mut self, instructions: InstructionSet) -> Self {
        self.instructions = instructions;
        self
    }

    /// Moves the anchor.
    ///
    /// # Panics
    /// When it is of another number of quantities, or has fewer rows than these.
    pub fn set(&mut self, anchored: &Anchored<'_>) {
        let p = anchored.deviation.len();
        let Self {
            chain,
            base_rotation,
            base_translation,
            ..
        } = self;
        assert_eq!(
            p,
            chain.len() + base_rotation.len() + base_translation.len(),
            "one deviation per quantity"
        );
        for quantity in [chain, base_rotation, base_translation]
            .into_iter()
            .flatten()
        {
            (quantity.anchor, quantity.effect_mm) = (
                anchored.deviation[quantity.at],
                anchored.effects_mm[quantity.at],
            );
        }
        let (constant, apart) = anchored.qt_residuals.split_at(p);
        self.constant[..p].copy_from_slice(constant);
        self.apart_mm2 = apart.iter().map(|b| b * b).sum();
        let mut panels = self.panels.iter_mut();
        for first in (0..p).step_by(ROWS) {
            for (column, panel) in (first..p).zip(&mut panels) {
                let entry = |row: usize| {
                    if row <= column {
                        anchored.triangle[column * anchored.n_rows + row]
                    } else {
                        0.0
                    }
                };
                *panel = std::array::from_fn(|row| entry(first + row));
            }
        }
        (self.base_arm_mm, self.rounding, self.size_mm) =
            (anchored.base_arm_mm, anchored.rounding, anchored.size_mm);
    }

    /// True if F, as the kernel computes it, is certainly above `limits`, mm². `deviations` as for [`super::LaneRobots::set`]; `room` is a buffer of
    /// the same size.
    pub fn exceeds(
        &self,
        deviations: &[Lanes],
        limits: &Lanes,
        room: &mut [Lanes],
    ) -> [bool; LANES] {
        let mut excess_mm2 = Lanes::ZERO;
        match self.instructions {
            InstructionSet::Avx512 => on_avx512(self, deviations, limits, room, &mut excess_mm2),
            InstructionSet::Avx2 => on_avx2(self, deviations, limits, room, &mut excess_mm2),
            InstructionSet::Baseline => {
                self.excess_with::<2, 4>(deviations, limits, room, &mut excess_mm2)
            }
        }
        excess_mm2.0.map(|excess_mm2| excess_mm2 > 0.0)
    }

    /// Excess of ‖r₀ + J·δ‖² over its allowed value. The result is written to memory: if single lanes were returned, the compiler would process
    /// everything before lane by lane.
    #[inline(always)]
    fn excess_with<const W: usize, const P: usize>(
        &self,
        deviations: &[Lanes],
        limits: &Lanes,
        room: &mut [Lanes],
        excess_mm2: &mut Lanes,
    ) {
        let (error, way) = self.remainder::<W, P>(deviations, room);
        let squares = self.linear_squares::<W, P>(room);
        for part in 0..P {
            let rounding = Vector::splat(self.rounding)
                * (way[part] + error[part] + Vector::splat(self.size_mm));
            let root = Vector::load(limits, part).sqrt() + (error[part] + rounding);
            (squares[part] - root * root).store(excess_mm2, part);
        }
    }

    /// Upper bounds of ‖e‖ and of the targets' displacement, over all poses. The deltas are computed in the same loops: in a loop of their own, the
    /// compiler would gather them across quantities, one lane after the other.
    #[inline(always)]
    fn remainder<const W: usize, const P: usize>(
        &self,
        deviations: &[Lanes],
        deltas: &mut [Lanes],
    ) -> ([Vector<W>; P], [Vector<W>; P]) {
        let (mut error, mut way) = ([Vector::<W>::splat(0.0); P], [Vector::<W>::splat(0.0); P]);
        for quantity in &self.chain {
            for part in 0..P {
                let size = quantity.delta::<W>(deviations, deltas, part).abs();
                let (angle, direct) = (
                    size * Vector::splat(quantity.turns),
                    size * Vector::splat(quantity.effect_mm),
                );
                turn(angle, direct, HALF, &mut error[part], &mut way[part]);
            }
        }
        if !self.base_rotation.is_empty() {
            let mut squares = [Vector::<W>::splat(0.0); P];
            for angle in &self.base_rotation {
                for (part, squares) in squares.iter_mut().enumerate() {
                    let size = angle.delta::<W>(deviations, deltas, part);
                    *squares = size.mul_add(size, *squares);
                }
            }
            for part in 0..P {
                let size = squares[part].sqrt();
                turn(
                    size,
                    size * Vector::splat(self.base_arm_mm),
                    THREE_QUARTERS,
                    &mut error[part],
                    &mut way[part],
                );
            }
        }
        for length in &self.base_translation {
            for (part, way) in way.iter_mut().enumerate() {
                *way = length
                    .delta(deviations, deltas, part)
                    .abs()
                    .mul_add(Vector::splat(length.effect_mm), *way);
            }
        }
        (error, way)
    }

    /// ‖c + R·δ‖² + ‖b‖².
    #[inline(always)]
    fn linear_squares<const W: usize, const P: usize>(&self, deltas: &[Lanes]) -> [Vector<W>; P] {
        let mut squares = [Vector::<W>::splat(self.apart_mm2); P];
        let mut rest = self.panels.as_slice();
        for (block, constant) in self.constant.chunks_exact(ROWS).enumerate() {
            let deltas = &deltas[block * ROWS..];
            let (panels, behind) = rest.split_at(deltas.len());
            rest = behind;
            let mut rows = [[Vector::<W>::splat(0.0); P]; ROWS];
            for (row, constant) in rows.iter_mut().zip(constant) {
                *row = [Vector::splat(*constant); P];
            }
            for (panel, delta) in panels.iter().zip(deltas) {
                for (row, factor) in rows.iter_mut().zip(panel) {
                    for (part, sum) in row.iter_mut().enumerate() {
                        *sum = Vector::splat(*factor).mul_add(Vector::load(delta, part), *sum);
                    }
                }
            }
            for row in rows {
                for part in 0..P {
                    squares[part] = row[part].mul_add(row[part], squares[part]);
                }
            }
        }
        squares
    }
}

/// Bound of an angle's own second derivative, times ½.
const HALF: f64 = 0.5;
/// As [`HALF`], for a rotation vector: ½ · 3/2.
const THREE_QUARTERS: f64 = 0.75;

/// Adds a quantity. It moves the target by `direct` at the anchor, and by up to angle · way more because of the quantities after it.
#[inline(always)]
fn turn<const W: usize>(
    angle: Vector<W>,
    direct: Vector<W>,
    own: f64,
    error: &mut Vector<W>,
    way: &mut Vector<W>,
) {
    let moved = angle.mul_add(*way, direct);
    *error = angle.mul_add(Vector::splat(own).mul_add(moved, *way), *error);
    *way = *way + moved;
}

#[multiversion(targets("x86_64+avx512f+avx512vl+fma"))]
fn on_avx512(
    bound: &LowerBound,
    deviations: &[Lanes],
    limits: &Lanes,
    room: &mut [Lanes],
    excess_mm2: &mut Lanes,
) {
    bound.excess_with::<8, 1>(deviations, limits, room, excess_mm2);
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn on_avx2(
    bound: &LowerBound,
    deviations: &[Lanes],
    limits: &Lanes,
    room: &mut [Lanes],
    excess_mm2: &mut Lanes,
) {
    bound.excess_with::<4, 2>(deviations, limits, room, excess_mm2);
}

/// Position of a quantity in the chain base … target; `None` for the base itself. Rx and Dx of a link commute, as do Rz and Dz. The length is placed
/// nearer to the base, so that its own angle does not turn it.
fn place(moved: &Moved) -> Option<(usize, u8)> {
    match *moved {
        Moved::BaseTranslation(_) | Moved::BaseRotation(_) => None,
        Moved::A(link) => Some((link, 0)),
        Moved::Alpha(link) => Some((link, 1)),
        Moved::Beta(link) => Some((link, 2)),
        Moved::D(link) => Some((link, 3)),
        Moved::ThetaOffset(link) => Some((link, 4)),
        Moved::Target(..) | Moved::Nothing => Some((usize::MAX, 0)),
    }
}
