//! References of instruments: whether their lengths agree.

use crate::wire::issue::Invalid;
use crate::wire::reference::{ReferenceBody, ReferenceLengthBody};

/// Largest deviation of a length from the common scale of all lengths, in its standard uncertainties. Beyond it the length contradicts the
/// others; for a correct length this happens by chance once in two million.
const MAX_STDS: f64 = 5.0;

/// Checks a new reference. Refuses lengths that have no common scale.
///
/// # Errors
/// Those of [`ReferenceBody::check`], and [`Invalid`] with the length that deviates most from the common scale.
pub fn check_reference(body: &ReferenceBody) -> Result<(), Invalid> {
    body.check()?;
    let Some(scale) = body.scale() else {
        return Ok(());
    };
    let left = |item: &ReferenceLengthBody| scale.residual_stds(&item.into());
    let all = body.items.iter().enumerate();
    let worst = all.max_by(|(_, a), (_, b)| left(a).abs().total_cmp(&left(b).abs()));
    match worst {
        Some((i, item)) if left(item).abs() > MAX_STDS => Err(Invalid::at(
            &format!("/items/{i}/measured_mm"),
            "contradictory_lengths",
            format!(
                "{}: {} mm were measured, {:+.4} mm from the scale that all lengths have in common, {:.0} of its standard uncertainties. Is it the right \
                 pair of lengths, has the instrument a constant error (another reflector), or is std_mm too small?",
                item.name,
                item.measured_mm,
                left(item) * item.std_mm,
                left(item).abs()
            ),
        )),
        _ => Ok(()),
    }
}
