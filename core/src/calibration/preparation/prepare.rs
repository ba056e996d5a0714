//! From a request to its problem: screens the points, chooses the parameters, and sets weights and priors.

use crate::calibration::preparation::loss::PointLoss;
use crate::calibration::preparation::motions::parameters_of;
use crate::calibration::preparation::observe::{
    Observed, nominal_model, observe, with_target_rotations,
};
use crate::calibration::preparation::row_weights::weigh;
use crate::calibration::preparation::screening::screen;
use crate::calibration::preparation::stated_priors::stated_priors;
use crate::calibration::problem::Problem;
use crate::calibration::request::CalibrationRequest;
use crate::calibration::settings::settings;
use crate::calibration::{Error, unusable};
use crate::identification::least_squares::linearisation::decomposition_at;
use crate::identification::least_squares::problem::reach_mm;
use crate::identification::model::identifiability::prior_scales;
use crate::measurement::Subset;
use crate::solvers::watch::Watch;

impl<'a> Problem<'a> {
    /// The problem of a request.
    pub fn new(request: &'a CalibrationRequest, watch: &Watch<'_>) -> Result<Self, Error> {
        Self::of(request, observe(request)?, watch)
    }

    /// The problem of a request whose points are already split. Screens the points and arranges them for the fit.
    ///
    /// # Errors
    /// [`Error::Cancelled`] when the watch stops, [`Error::Unusable`] if nothing can be identified.
    pub fn of(
        request: &'a CalibrationRequest,
        mut observed: Observed,
        watch: &Watch<'_>,
    ) -> Result<Self, Error> {
        let (screening, arrangement) = screen(request, &mut observed, watch)?;
        let identify = observed.of(Subset::Identify);
        let parameters =
            with_target_rotations(parameters_of(request, &screening.targets)?, &identify);
        let nominal = nominal_model(request, &identify, screening.targets.len());
        let scale = prior_scales(&parameters, reach_mm(&nominal.links, identify.iter()));
        let decomposition = decomposition_at(&nominal, &parameters, &scale, &identify);
        if decomposition.rank() == 0 {
            return Err(unusable(
                "nothing_to_identify",
                "the measured positions depend on none of the free parameters: free others as well",
            ));
        }
        let loss = PointLoss::of(request, &screening)?;
        let (settings, priors) = (settings(request), None);
        let mut problem = Self {
            request,
            settings,
            observed,
            screening,
            arrangement,
            loss,
            identify,
            parameters,
            nominal,
            decomposition,
            priors,
            least_sigma_mm: request.set.rounding_std_mm(),
        };
        weigh(&mut problem, watch)?;
        problem.priors = stated_priors(&problem, watch)?;
        Ok(problem)
    }
}
