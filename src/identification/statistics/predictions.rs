//! Uncertainty of predicted positions, with the corrections that they contain.

use crate::identification::corrections::corrected::IdentifiedRobot;
use crate::identification::statistics::changes::Estimate;

impl Estimate {
    /// Standard deviation (3-D: the root of the sum of three variances) of a target position predicted by `robot`, mm.
    pub fn predicted_std_mm(&self, robot: &IdentifiedRobot, q_rad: &[f64], target: usize) -> f64 {
        let parameters = &self.parameters;
        faded(self, robot, q_rad, |with_corrections| {
            let corrected = self.corrected.as_ref().zip(robot.corrected.as_ref());
            match corrected.filter(|_| with_corrections) {
                Some((errors, model)) => errors.position_std_mm(model, parameters, q_rad, target),
                None => (self.uncertainty).position_std_mm(&self.model, parameters, q_rad, target),
            }
        })
    }
}

/// The standard deviation at a pose where corrections have the weight of their region, from that with corrections (`std_mm(true)`) and that of the links
/// alone (`std_mm(false)`). The standard deviation of a weighted mean of two predictions is at most the mean of theirs.
pub fn faded(
    estimate: &Estimate,
    robot: &IdentifiedRobot,
    q_rad: &[f64],
    std_mm: impl Fn(bool) -> f64,
) -> f64 {
    let weight = match estimate.corrected {
        Some(_) => robot.weight(q_rad),
        None => 0.0,
    };
    let part = |weight: f64, with_corrections| match weight > 0.0 {
        true => weight * std_mm(with_corrections),
        false => 0.0,
    };
    part(weight, true) + part(1.0 - weight, false)
}
