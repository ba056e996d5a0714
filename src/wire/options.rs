//! Search options of a job, and their limits.

use crate::calibration::request::{Loss, SearchOptions};
use crate::wire::issue::Checker;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Minimum number of particles of a swarm.
pub const MIN_PARTICLES: usize = 2;
/// Maximum number of particles of a swarm: five hundred times the number in the paper.
pub const MAX_PARTICLES: usize = 100_000;
/// Maximum number of swarm updates.
pub const MAX_ITERATIONS: usize = 100_000;
/// Maximum number of cost evaluations of one job. They take minutes on one core, so that no job blocks a worker for hours.
pub const MAX_EVALUATIONS: usize = 50_000_000;
/// Maximum half-width of the search box for lengths, mm. With larger errors the nominal robot would be a different robot.
pub const MAX_HALF_WIDTH_MM: f64 = 1_000.0;
/// Maximum half-width of the search box for angles, degrees.
pub const MAX_HALF_WIDTH_DEG: f64 = 180.0;
/// Maximum inertia weight and acceleration coefficient. A swarm already diverges above 4.
pub const MAX_COEFFICIENT: f64 = 10.0;
/// Maximum of `stop_at_cost_mm2`, mm².
pub(super) const MAX_COST_MM2: f64 = 1e12;

/// Search options. An absent option takes the value of the preset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct OptionsBody {
    /// Number of particles in the swarm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 2, maximum = 100000)]
    pub n_particles: Option<usize>,
    /// Maximum number of swarm updates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 100000)]
    pub n_iterations: Option<usize>,
    /// Inertia weight w (paper, eq. 9).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 10)]
    pub inertia_weight: Option<f64>,
    /// Cognitive coefficient c1 (paper, eq. 9).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 10)]
    pub cognitive: Option<f64>,
    /// Social coefficient c2 (paper, eq. 9).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 10)]
    pub social: Option<f64>,
    /// Half-width of the search box for lengths, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0, maximum = 1000)]
    pub search_half_width_mm: Option<f64>,
    /// Half-width of the search box for angles, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0, maximum = 180)]
    pub search_half_width_deg: Option<f64>,
    /// Stop when the cost F on the identify subset is at or below this value, mm².
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0)]
    pub stop_at_cost_mm2: Option<f64>,
    /// Loss function of the residuals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub loss: Option<Loss>,
}

impl OptionsBody {
    /// Reports every option that is out of its range.
    pub fn check(&self, checker: &mut Checker) {
        let number = "a number of the search";
        checker.within(
            "/options/n_particles",
            self.n_particles,
            MIN_PARTICLES..=MAX_PARTICLES,
            number,
        );
        checker.within(
            "/options/n_iterations",
            self.n_iterations,
            0..=MAX_ITERATIONS,
            number,
        );
        let evaluations = self
            .n_particles
            .unwrap_or(0)
            .saturating_mul(self.n_iterations.unwrap_or(0));
        if evaluations > MAX_EVALUATIONS {
            let detail = format!(
                "n_particles × n_iterations is {evaluations}; at most {MAX_EVALUATIONS} cost evaluations are allowed"
            );
            checker.add("/options/n_iterations", "too_much_work", detail);
        }
        for (name, value, max) in [
            ("inertia_weight", self.inertia_weight, MAX_COEFFICIENT),
            ("cognitive", self.cognitive, MAX_COEFFICIENT),
            ("social", self.social, MAX_COEFFICIENT),
            ("stop_at_cost_mm2", self.stop_at_cost_mm2, MAX_COST_MM2),
        ] {
            checker.within(format!("/options/{name}"), value, 0.0..=max, number);
        }
        for (name, value, max) in [
            ("mm", self.search_half_width_mm, MAX_HALF_WIDTH_MM),
            ("deg", self.search_half_width_deg, MAX_HALF_WIDTH_DEG),
        ] {
            let pointer = format!("/options/search_half_width_{name}");
            checker.above_zero(pointer, value, max, "half the width of the search box");
        }
    }
}

impl From<OptionsBody> for SearchOptions {
    fn from(body: OptionsBody) -> Self {
        Self {
            n_particles: body.n_particles,
            n_iterations: body.n_iterations,
            inertia_weight: body.inertia_weight,
            cognitive: body.cognitive,
            social: body.social,
            search_half_width_mm: body.search_half_width_mm,
            search_half_width_deg: body.search_half_width_deg,
            stop_at_cost_mm2: body.stop_at_cost_mm2,
            loss: body.loss,
        }
    }
}
