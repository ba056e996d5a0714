//! Lengths, joint zeros and joint maps as texts of the upload check.

use super::fitting::Zeroed;
use crate::kinematics::JointMap;

/// Zero errors of a joint below this are not reported, degrees.
const OFFSET_DEG: f64 = 0.3;

/// A length as text: to a tenth of a millimetre, or with three digits if it is smaller.
pub fn mm(length_mm: f64) -> String {
    let digits = [10.0, 1.0, 0.1, 0.01]
        .iter()
        .filter(|from| length_mm < **from)
        .count();
    format!("{length_mm:.0$}", digits + 1)
}

/// The joints whose zeros are off, with their zero errors.
pub fn offsets(zeros: &Zeroed) -> Option<String> {
    let words: Vec<String> = zeros
        .offsets_rad
        .iter()
        .zip(1..)
        .map(|(offset_rad, joint)| (offset_rad.to_degrees(), joint))
        .filter(|(offset_deg, _)| offset_deg.abs() > OFFSET_DEG)
        .map(|(offset_deg, joint)| format!("{offset_deg:+.2}° (joint {joint})"))
        .collect();
    (!words.is_empty()).then(|| words.join(", "))
}

/// True if [`offsets`] names joint 1.
pub fn names_first_joint(zeros: &Zeroed) -> bool {
    let first_rad = zeros.offsets_rad.first();
    first_rad.is_some_and(|offset_rad| offset_rad.to_degrees().abs() > OFFSET_DEG)
}

/// A joint map in the form of a robot's JSON.
pub fn in_words(map: &JointMap) -> String {
    let list = |values: &mut dyn Iterator<Item = f64>| {
        let numbers: Vec<String> = values.map(|value| format!("{value}")).collect();
        format!("[{}]", numbers.join(", "))
    };
    let rows: Vec<String> = map
        .coupling
        .row_iter()
        .map(|row| list(&mut row.iter().copied()))
        .collect();
    format!(
        "{{\"sign\": {}, \"offset_deg\": {}, \"coupling\": [{}]}}",
        list(&mut map.sign.iter().copied()),
        list(&mut map.offset_rad.iter().map(|offset| rounded_deg(*offset))),
        rows.join(", ")
    )
}

/// Degrees, without the rounding errors of the conversion from radians.
fn rounded_deg(rad: f64) -> f64 {
    (rad.to_degrees() * 1e9).round() / 1e9
}
