//! Checks of a result before it is stored.

use crate::calibration::CalibrationReport;
use crate::wire::robot::MAX_LENGTH_MM;

/// Whether links and targets have plausible sizes. A fit to rows that do not belong together may diverge.
pub fn has_plausible_size(core: &CalibrationReport) -> bool {
    let links = core.links.iter().flat_map(|l| [l.a_mm, l.d_mm]);
    let targets = core.targets_mm.iter().flat_map(|t| [t.x, t.y, t.z]);
    links.chain(targets).all(|mm| mm.abs() <= MAX_LENGTH_MM)
}

/// Whether all numbers of the result are finite. JSON cannot represent other numbers.
pub fn is_finite(core: &CalibrationReport) -> bool {
    let subsets = [Some(&core.identify), core.verify.as_ref()];
    let errors = subsets
        .into_iter()
        .flatten()
        .flat_map(|s| [Some(s.before), Some(s.after), s.corrected])
        .flatten();
    let compared = core.comparison.iter().filter_map(|c| c.verify_after);
    let statistics = errors
        .chain(compared)
        .flat_map(|e| [e.mean_mm, e.std_mm, e.rms_mm, e.max_mm]);
    let parameters = core
        .parameters
        .iter()
        .flat_map(|p| [p.nominal, p.identified, p.delta]);
    let points = core.per_point.iter().flat_map(|p| {
        [
            p.before_mm,
            p.after_mm,
            p.corrected_vector_mm.map_or(0.0, |v| v.norm()),
        ]
    });
    let links = core
        .links
        .iter()
        .flat_map(|l| [l.a_mm, l.alpha_rad, l.d_mm, l.theta_offset_rad, l.beta_rad]);
    let base = core.t_instrument_base.to_homogeneous();
    let targets = core.targets_mm.iter().flat_map(|t| [t.x, t.y, t.z]);
    let costs = core
        .comparison
        .iter()
        .map(|c| c.cost_mm2)
        .chain(core.convergence_mm2.iter().copied())
        .chain([core.cost_mm2]);
    statistics
        .chain(parameters)
        .chain(points)
        .chain(links)
        .chain(base.iter().copied())
        .chain(targets)
        .chain(costs)
        .all(f64::is_finite)
}
