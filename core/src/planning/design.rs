//! Exchange algorithm: selects candidates that minimise tr(M⁻¹·W), with M the information of the selected ones and W that of the workspace.

use nalgebra::{DMatrix, SMatrix};

/// Maximum number of passes of exchanges.
const MAX_PASSES: usize = 6;
/// After the first selection, exchanges consider only this number of the most useful candidates.
const N_PROMISING: usize = 2_000;
/// A selection is tight if it has fewer rows than the number of unknown parameter combinations plus this number. If a pose is then removed,
/// only priors determine some combinations. The covariance grows by so many orders of magnitude that an update of it would be only
/// rounding; it is therefore recomputed.
const SPARE_ROWS: usize = 18;
/// Number of rows by which a tight selection first exceeds its final number.
const EXTRA_ROWS: usize = 12;
/// Combinations whose squared effect on the tool is below this share of the largest are not counted.
const MOVES: f64 = 1e-12;
/// A combination is already known if its prior information is at least this multiple of that of a new robot.
const KNOWN_PRIOR_RATIO: f64 = 100.0;
/// Minimum relative decrease of the criterion for an exchange.
const MIN_RELATIVE_DECREASE: f64 = 1e-9;

/// A symmetric matrix of a candidate.
type Square<const ROWS: usize> = SMatrix<f64, ROWS, ROWS>;

/// The candidates, the selected ones, and A = M⁻¹. A candidate has `ROWS` rows J: three if its position is measured, six if its pose is.
#[derive(Debug)]
pub struct Design<const ROWS: usize> {
    /// Jᵀ of all candidates, side by side.
    candidates: DMatrix<f64>,
    /// The candidates that are considered.
    members: Vec<usize>,
    /// Jᵀ of the members.
    columns: DMatrix<f64>,
    /// J·A·Jᵀ of each member.
    predicted_covariance: Vec<Square<ROWS>>,
    /// J·A·W·A·Jᵀ of each member.
    gain_matrix: Vec<Square<ROWS>>,
    prior: DMatrix<f64>,
    covariance: DMatrix<f64>,
    workspace_information: DMatrix<f64>,
    chosen: Vec<usize>,
}

impl<const ROWS: usize> Design<ROWS> {
    /// A design with nothing selected. `rows` has `ROWS` rows per candidate, `prior` is the prior information, `interest` is W.
    pub fn new(
        rows: &DMatrix<f64>,
        prior: &DMatrix<f64>,
        workspace_information: &DMatrix<f64>,
    ) -> Self {
        let n = prior.nrows();
        let covariance = inverse(prior.clone()).unwrap_or_else(|| DMatrix::identity(n, n));
        let members = (0..rows.nrows() / ROWS).collect();
        let mut design = Self {
            candidates: rows.transpose(),
            members,
            columns: DMatrix::zeros(n, 0),
            predicted_covariance: vec![],
            gain_matrix: vec![],
            prior: prior.clone(),
            covariance,
            workspace_information: workspace_information.clone(),
            chosen: vec![],
        };
        design.rebuild();
        design
    }

    /// Selects `n` candidates and returns their indices. If there are hardly more rows than parameters, more candidates are selected first,
    /// and those whose removal costs least are then removed. If only `n` were added one by one, the first ones would be used for parameters
    /// that only priors determine.
    pub fn choose(mut self, n: usize) -> Vec<usize> {
        let n_all = self.candidates.ncols() / ROWS;
        let n = n.min(n_all);
        let is_tight = ROWS * n < self.n_unknown() + SPARE_ROWS;
        let first = if is_tight {
            (n + EXTRA_ROWS / ROWS).min(n_all)
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
        let moves = self.workspace_information.symmetric_eigenvalues();
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
                // Moves the new candidate from the last place to the slot.
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
            inverse(self.information(others)).map_or(f64::INFINITY, |covariance| {
                covariance.dot(&self.workspace_information)
            })
        };
        let gain_matrix: Vec<f64> = (0..self.chosen.len()).map(without).collect();
        if let Some(slot) =
            (0..gain_matrix.len()).min_by(|a, b| gain_matrix[*a].total_cmp(&gain_matrix[*b]))
        {
            self.chosen.remove(slot);
            self.refresh();
        }
    }

    fn criterion(&self) -> f64 {
        self.covariance.dot(&self.workspace_information)
    }

    /// The criterion computed directly from the selected candidates and optionally one more, for cases in which an update would be only rounding.
    fn exact_criterion(&self, more: Option<usize>) -> f64 {
        let covariance = inverse(self.information(self.chosen.iter().copied().chain(more)));
        covariance.map_or(f64::INFINITY, |covariance| {
            covariance.dot(&self.workspace_information)
        })
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
        let gain = |(predicted_covariance, gain_matrix): (&Square<ROWS>, &Square<ROWS>)| {
            let k = predicted_covariance + Square::identity();
            k.try_inverse()
                .map_or(0.0, |inverse| inverse.dot(gain_matrix))
        };
        self.predicted_covariance
            .iter()
            .zip(&self.gain_matrix)
            .map(gain)
            .collect()
    }

    /// Adds or removes a candidate: A' = A − U·C·Uᵀ with U = A·Jᵀ, C = (I + J·U)⁻¹, or −(I − J·U)⁻¹.
    ///
    /// For each member, with E = J·U, F = J·V, V = A·W·U and S = Uᵀ·W·U: J·A·Jᵀ decreases by E·C·Eᵀ, and J·A·W·A·Jᵀ changes by
    /// − E·C·Fᵀ − F·C·Eᵀ + E·C·S·C·Eᵀ.
    fn change(&mut self, candidate: usize, is_added: bool) {
        if is_added {
            self.chosen.push(candidate);
        } else {
            self.chosen.retain(|chosen| *chosen != candidate);
        }
        let of_candidate = self.candidates.fixed_columns::<ROWS>(ROWS * candidate);
        let u = &self.covariance * of_candidate;
        let predicted_covariance: Square<ROWS> = of_candidate.tr_mul(&u);
        let core = if is_added {
            Square::identity() + predicted_covariance
        } else {
            predicted_covariance - Square::identity()
        };
        let Some(c) = core.try_inverse() else {
            return self.refresh();
        };
        let through = &self.workspace_information * &u;
        let v = &self.covariance * &through;
        let s: Square<ROWS> = u.tr_mul(&through);
        let (e, f) = (self.columns.tr_mul(&u), self.columns.tr_mul(&v));
        let members = self
            .predicted_covariance
            .iter_mut()
            .zip(&mut self.gain_matrix);
        for (i, (predicted_covariance, gain_matrix)) in members.enumerate() {
            let e = e.fixed_view::<ROWS, ROWS>(ROWS * i, 0);
            let f = f.fixed_view::<ROWS, ROWS>(ROWS * i, 0);
            let ec = e * c;
            *predicted_covariance -= ec * e.transpose();
            *gain_matrix += (ec * s * c - f * c) * e.transpose() - ec * f.transpose();
        }
        self.covariance -= &u * c * u.transpose();
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
            let columns = self.candidates.fixed_columns::<ROWS>(ROWS * candidate);
            sum + columns * columns.transpose()
        })
    }

    fn rebuild(&mut self) {
        let of_member = |member: &usize| ROWS * member..ROWS * (member + 1);
        let columns: Vec<usize> = self.members.iter().flat_map(of_member).collect();
        self.columns = self.candidates.select_columns(&columns);
        let wawa = &self.covariance * &self.workspace_information * &self.covariance;
        self.predicted_covariance = quadratic(&self.columns, &self.covariance);
        self.gain_matrix = quadratic(&self.columns, &wawa);
    }
}

/// M⁻¹; `None` if the matrix is not positive definite.
fn inverse(information: DMatrix<f64>) -> Option<DMatrix<f64>> {
    information.cholesky().map(|root| root.inverse())
}

/// J·B·Jᵀ of each candidate, from the Jᵀ of all.
fn quadratic<const ROWS: usize>(columns: &DMatrix<f64>, b: &DMatrix<f64>) -> Vec<Square<ROWS>> {
    let through = b * columns;
    let of = |m: usize| {
        let columns = columns.fixed_columns::<ROWS>(ROWS * m);
        columns.tr_mul(&through.fixed_columns::<ROWS>(ROWS * m))
    };
    (0..columns.ncols() / ROWS).map(of).collect()
}
