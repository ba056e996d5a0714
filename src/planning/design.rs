//! Exchange algorithm: selects candidates that minimise tr(M⁻¹·W), with M the information of the selected ones and W that of the workspace.

use nalgebra::{DMatrix, SMatrix};

/// Number of candidates side by side in one or two vector registers.
const LANES: usize = 8;
/// Maximum number of passes of exchanges.
const MAX_PASSES: usize = 6;
/// After the first selection, exchanges consider only this number of the most useful candidates.
const N_PROMISING: usize = 2_000;
/// A selection is tight if it has fewer rows than the unknown combinations of parameters plus this number. If a pose is then removed, only priors
/// determine some of them. The covariance grows by so many orders of magnitude that an update of it is only rounding, and it is computed again from
/// the start.
const SPARE_ROWS: usize = 18;
/// Rows that a tight selection has too many at first.
const EXTRA_ROWS: usize = 12;
/// Combinations that move the tool by less than this share of the largest, squared, are not counted.
const MOVES: f64 = 1e-12;
/// A combination is known already if its prior information is at least this many times that of a new robot.
const KNOWN_PRIOR_RATIO: f64 = 100.0;
/// Minimum relative decrease of the criterion for an exchange.
const MIN_RELATIVE_DECREASE: f64 = 1e-9;

type Lanes = [f64; LANES];
/// A symmetric matrix of each lane, of which only the lower triangle is used.
type Symmetric<const ROWS: usize> = [[Lanes; ROWS]; ROWS];

/// Eight candidates: their rows, column by column, and two symmetric matrices each.
#[derive(Clone, Debug)]
struct Block<const ROWS: usize> {
    /// One entry per parameter.
    rows: Vec<[Lanes; ROWS]>,
    /// J·A·Jᵀ.
    spread: Symmetric<ROWS>,
    /// J·A·W·A·Jᵀ.
    worth: Symmetric<ROWS>,
}

/// The candidates, the selected ones, and A = M⁻¹. A candidate has `ROWS` rows: three if its position is measured, six if its pose is.
#[derive(Debug)]
pub struct Design<'a, const ROWS: usize> {
    candidates: &'a DMatrix<f64>,
    /// Candidate in each lane of the blocks.
    members: Vec<usize>,
    blocks: Vec<Block<ROWS>>,
    prior: DMatrix<f64>,
    covariance: DMatrix<f64>,
    interest: DMatrix<f64>,
    chosen: Vec<usize>,
}

impl<'a, const ROWS: usize> Design<'a, ROWS> {
    /// A design with nothing selected. `rows` has `ROWS` rows per candidate, `prior` is the prior information, `interest` is W.
    pub fn new(rows: &'a DMatrix<f64>, prior: &DMatrix<f64>, interest: &DMatrix<f64>) -> Self {
        let n = prior.nrows();
        let covariance = inverse(prior.clone()).unwrap_or_else(|| DMatrix::identity(n, n));
        let members = (0..rows.nrows() / ROWS).collect();
        let mut design = Self {
            candidates: rows,
            members,
            blocks: vec![],
            prior: prior.clone(),
            covariance,
            interest: interest.clone(),
            chosen: vec![],
        };
        design.rebuild();
        design
    }

    /// Selects `n` candidates and returns their indices. If there are hardly more rows than parameters, more are selected first, and those that are
    /// missed least are then removed. Adding one after the other would spend the first candidates on parameters that only priors determine.
    pub fn choose(mut self, n: usize) -> Vec<usize> {
        let n = n.min(self.candidates.nrows() / ROWS);
        let is_tight = ROWS * n < self.n_unknown() + SPARE_ROWS;
        let first = if is_tight {
            (n + EXTRA_ROWS / ROWS).min(self.candidates.nrows() / ROWS)
        } else {
            n
        };
        while self.chosen.len() < first {
            let Some((best, _)) = self.best() else { break };
            self.change(best, true);
        }
        self.keep_promising();
        self.exchange(is_tight);
        while self.chosen.len() > n {
            self.leave_one_out();
            self.exchange(is_tight);
        }
        self.chosen
    }

    /// Number of combinations that move the tool, without those that are known already.
    fn n_unknown(&self) -> usize {
        let moves = self.interest.symmetric_eigenvalues();
        let least = MOVES * moves.max();
        let n_moving = moves.iter().filter(|value| **value > least).count();
        let known = self.prior.symmetric_eigenvalues();
        let n_known = known
            .iter()
            .filter(|value| **value > KNOWN_PRIOR_RATIO)
            .count();
        n_moving.saturating_sub(n_known)
    }

    fn exchange(&mut self, is_tight: bool) {
        for _ in 0..MAX_PASSES {
            let mut is_better = false;
            for slot in 0..self.chosen.len() {
                let old = self.chosen[slot];
                let before = if is_tight {
                    self.exact_criterion(None)
                } else {
                    self.criterion()
                };
                self.change(old, false);
                if is_tight {
                    self.refresh();
                }
                let Some((best, gain)) = self.best() else {
                    break;
                };
                let after = if is_tight {
                    self.exact_criterion(Some(best))
                } else {
                    self.criterion() - gain
                };
                let keep = best == old || after >= before * (1.0 - MIN_RELATIVE_DECREASE);
                self.change(if keep { old } else { best }, true);
                // move the new candidate from the last place to the slot
                let last = self.chosen.len() - 1;
                self.chosen[slot..=last].rotate_right(1);
                is_better |= !keep;
            }
            if !is_better {
                break;
            }
        }
    }

    /// Removes the candidate without which the criterion is smallest.
    fn leave_one_out(&mut self) {
        let without = |slot: usize| {
            let others = self
                .chosen
                .iter()
                .enumerate()
                .filter(|(at, _)| *at != slot)
                .map(|(_, candidate)| *candidate);
            inverse(self.information(others))
                .map_or(f64::INFINITY, |covariance| covariance.dot(&self.interest))
        };
        let worth: Vec<f64> = (0..self.chosen.len()).map(without).collect();
        if let Some(slot) = (0..worth.len()).min_by(|a, b| worth[*a].total_cmp(&worth[*b])) {
            self.chosen.remove(slot);
            self.refresh();
        }
    }

    fn criterion(&self) -> f64 {
        self.covariance.dot(&self.interest)
    }

    /// The criterion computed directly from the selected candidates and optionally one more, for cases in which an update would be only rounding.
    fn exact_criterion(&self, more: Option<usize>) -> f64 {
        let covariance = inverse(self.information(self.chosen.iter().copied().chain(more)));
        covariance.map_or(f64::INFINITY, |covariance| covariance.dot(&self.interest))
    }

    fn rows_of(&self, candidate: usize) -> DMatrix<f64> {
        self.candidates.rows(ROWS * candidate, ROWS).into_owned()
    }

    /// The candidate that lowers the criterion most, and the decrease: tr((I + J·A·Jᵀ)⁻¹·J·A·W·A·Jᵀ).
    fn best(&self) -> Option<(usize, f64)> {
        let mut best: Option<(usize, f64)> = None;
        for (at, gain) in self.gains().into_iter().enumerate() {
            let candidate = self.members[at];
            if best.is_none_or(|(_, most)| gain > most) && !self.chosen.contains(&candidate) {
                best = Some((candidate, gain));
            }
        }
        best
    }

    fn gains(&self) -> Vec<f64> {
        let gain = |at: usize| {
            let block = &self.blocks[at / LANES];
            let k = of_lane(&block.spread, at % LANES) + SMatrix::identity();
            k.try_inverse().map_or(0.0, |inverse| {
                inverse.dot(&of_lane(&block.worth, at % LANES))
            })
        };
        (0..self.members.len()).map(gain).collect()
    }

    /// Adds or removes a candidate: A' = A − U·C·Uᵀ with U = A·Jᵀ, C = (I + J·U)⁻¹, or −(I − J·U)⁻¹.
    fn change(&mut self, candidate: usize, is_added: bool) {
        if is_added {
            self.chosen.push(candidate);
        } else {
            self.chosen.retain(|chosen| *chosen != candidate);
        }
        let rows = self.rows_of(candidate);
        let u = &self.covariance * rows.transpose();
        let spread: SMatrix<f64, ROWS, ROWS> = small(&(&rows * &u));
        let core = if is_added {
            SMatrix::identity() + spread
        } else {
            spread - SMatrix::identity()
        };
        let Some(c) = core.try_inverse() else {
            return self.refresh();
        };
        let through = &self.interest * &u;
        let v = &self.covariance * &through;
        let s = small(&u.tr_mul(&through));
        for block in &mut self.blocks {
            block.update(&u, &v, &c, &s);
        }
        let dynamic = DMatrix::from_fn(ROWS, ROWS, |i, j| c[(i, j)]);
        self.covariance -= &u * dynamic * u.transpose();
    }

    /// Keeps only the most useful candidates and the selected ones.
    fn keep_promising(&mut self) {
        let gains = self.gains();
        let mut order: Vec<usize> = (0..self.members.len()).collect();
        order.sort_by(|a, b| gains[*b].total_cmp(&gains[*a]).then(a.cmp(b)));
        let mut kept: Vec<usize> = order
            .into_iter()
            .take(N_PROMISING)
            .map(|at| self.members[at])
            .chain(self.chosen.iter().copied())
            .collect();
        kept.sort_unstable();
        kept.dedup();
        self.members = kept;
        self.rebuild();
    }

    /// Recomputes the covariance from the selected candidates.
    fn refresh(&mut self) {
        if let Some(covariance) = inverse(self.information(self.chosen.iter().copied())) {
            self.covariance = covariance;
        }
        self.rebuild();
    }

    fn information(&self, chosen: impl Iterator<Item = usize>) -> DMatrix<f64> {
        chosen.fold(self.prior.clone(), |sum, candidate| {
            let rows = self.rows_of(candidate);
            sum + rows.tr_mul(&rows)
        })
    }

    fn rebuild(&mut self) {
        let wawa = &self.covariance * &self.interest * &self.covariance;
        let p = self.covariance.nrows();
        self.blocks = self
            .members
            .chunks(LANES)
            .map(|members| block(self.candidates, members, p, &self.covariance, &wawa))
            .collect();
    }
}

/// M⁻¹; `None` if the matrix is not positive definite.
fn inverse(information: DMatrix<f64>) -> Option<DMatrix<f64>> {
    information.cholesky().map(|root| root.inverse())
}

fn block<const ROWS: usize>(
    candidates: &DMatrix<f64>,
    members: &[usize],
    p: usize,
    covariance: &DMatrix<f64>,
    worth: &DMatrix<f64>,
) -> Block<ROWS> {
    let lane = |k: usize, row: usize| {
        std::array::from_fn(|lane| {
            members
                .get(lane)
                .map_or(0.0, |c| candidates[(ROWS * c + row, k)])
        })
    };
    let rows: Vec<[Lanes; ROWS]> = (0..p)
        .map(|k| std::array::from_fn(|row| lane(k, row)))
        .collect();
    Block {
        spread: quadratic(&rows, covariance),
        worth: quadratic(&rows, worth),
        rows,
    }
}

/// J·B·Jᵀ of each lane.
fn quadratic<const ROWS: usize>(rows: &[[Lanes; ROWS]], b: &DMatrix<f64>) -> Symmetric<ROWS> {
    let mut sum = [[[0.0; LANES]; ROWS]; ROWS];
    for (l, right) in rows.iter().enumerate() {
        let mut through = [[0.0; LANES]; ROWS];
        for (k, left) in rows.iter().enumerate() {
            let factor = b[(k, l)];
            for row in 0..ROWS {
                for lane in 0..LANES {
                    through[row][lane] += left[row][lane] * factor;
                }
            }
        }
        for i in 0..ROWS {
            for j in 0..=i {
                for lane in 0..LANES {
                    sum[i][j][lane] += through[i][lane] * right[j][lane];
                }
            }
        }
    }
    sum
}

fn small<const ROWS: usize>(m: &DMatrix<f64>) -> SMatrix<f64, ROWS, ROWS> {
    SMatrix::from_fn(|i, j| m[(i, j)])
}

fn of_lane<const ROWS: usize>(m: &Symmetric<ROWS>, lane: usize) -> SMatrix<f64, ROWS, ROWS> {
    SMatrix::from_fn(|i, j| m[i.max(j)][i.min(j)][lane])
}

/// E·C of each lane.
fn product<const ROWS: usize>(
    e: &[[Lanes; ROWS]; ROWS],
    c: &SMatrix<f64, ROWS, ROWS>,
) -> [[Lanes; ROWS]; ROWS] {
    let mut product = [[[0.0; LANES]; ROWS]; ROWS];
    for (row, of) in product.iter_mut().zip(e) {
        for (column, sum) in row.iter_mut().enumerate() {
            for (k, of) in of.iter().enumerate() {
                for lane in 0..LANES {
                    sum[lane] += of[lane] * c[(k, column)];
                }
            }
        }
    }
    product
}

impl<const ROWS: usize> Block<ROWS> {
    /// With E = J·U, F = J·V, V = A·W·U and S = Uᵀ·W·U: J·A·Jᵀ decreases by E·C·Eᵀ, and J·A·W·A·Jᵀ changes by − E·C·Fᵀ − F·C·Eᵀ + E·C·S·C·Eᵀ.
    fn update(
        &mut self,
        u: &DMatrix<f64>,
        v: &DMatrix<f64>,
        c: &SMatrix<f64, ROWS, ROWS>,
        s: &SMatrix<f64, ROWS, ROWS>,
    ) {
        let (e, f) = (self.times(u), self.times(v));
        let (ec, ecsc, fc) = (product(&e, c), product(&e, &(c * s * c)), product(&f, c));
        for i in 0..ROWS {
            for j in 0..=i {
                for lane in 0..LANES {
                    let (mut spread, mut worth) = (0.0, 0.0);
                    for k in 0..ROWS {
                        let (ej, fj) = (e[j][k][lane], f[j][k][lane]);
                        spread += ec[i][k][lane] * ej;
                        worth += (ecsc[i][k][lane] - fc[i][k][lane]) * ej - ec[i][k][lane] * fj;
                    }
                    self.spread[i][j][lane] -= spread;
                    self.worth[i][j][lane] += worth;
                }
            }
        }
    }

    /// J·B for a p × `ROWS` matrix B.
    fn times(&self, b: &DMatrix<f64>) -> [[Lanes; ROWS]; ROWS] {
        let mut product = [[[0.0; LANES]; ROWS]; ROWS];
        for (k, rows) in self.rows.iter().enumerate() {
            for column in 0..ROWS {
                let factor = b[(k, column)];
                for row in 0..ROWS {
                    for lane in 0..LANES {
                        product[row][column][lane] += rows[row][lane] * factor;
                    }
                }
            }
        }
        product
    }
}
