//! Text about the mounting and the payload of the arm: as stated, and as the kept corrections were fitted. Also about points that were left
//! out by hand.

use super::Sources;
use super::text::{fixed, number};
use crate::wire::corrections::PayloadBody;
use crate::wire::robot::{MountingBody, NamedMounting};

/// The mounting as stated, and the direction of gravity for which the kept corrections are valid.
pub fn mounting(sources: &Sources<'_>) -> String {
    let stated = match &sources.robot.mounting {
        Some(stated) => format!("as stated: {}", stated_mounting(stated)),
        None => "not stated: on the floor is assumed".into(),
    };
    let fitted = sources
        .parameter_set
        .and_then(|set| set.corrections.as_ref());
    match fitted {
        Some(kept) => format!(
            "{stated}; as fitted: gravity along {} of the base",
            direction(kept.gravity_in_base)
        ),
        None => stated,
    }
}

fn stated_mounting(mounting: &MountingBody) -> String {
    match mounting {
        MountingBody::Named(NamedMounting::Floor) => "on the floor".into(),
        MountingBody::Named(NamedMounting::Wall) => "on a wall".into(),
        MountingBody::Named(NamedMounting::Ceiling) => "from the ceiling".into(),
        MountingBody::Direction(stated) => format!(
            "gravity along {} of the base, known to {}°",
            direction(stated.gravity_in_base),
            number(stated.std_deg)
        ),
    }
}

fn direction([x, y, z]: [f64; 3]) -> String {
    format!("({}, {}, {})", fixed(x, 3), fixed(y, 3), fixed(z, 3))
}

/// The payload that the job states.
pub fn stated_payload(sources: &Sources<'_>) -> Option<PayloadBody> {
    sources.job?.request.payload
}

/// The payload as stated, and the one for which the kept corrections are valid.
pub fn payload(sources: &Sources<'_>) -> String {
    let stated = match stated_payload(sources) {
        Some(payload) => format!("as stated: {}", payload_words(&payload)),
        None => "not stated".into(),
    };
    let fitted = sources
        .parameter_set
        .and_then(|set| set.corrections.as_ref());
    match fitted.map(|kept| kept.payload) {
        Some(Some(payload)) => format!("{stated}; as fitted: {}", payload_words(&payload)),
        Some(None) => format!("{stated}; as fitted: what was on the flange while measuring"),
        None => stated,
    }
}

fn payload_words(payload: &PayloadBody) -> String {
    let [x, y, z] = payload.centre_mm.map(number);
    let mass = number(payload.mass_kg);
    format!("{mass} kg, centre at {x}, {y}, {z} mm in the flange frame")
}

/// The points that somebody left out of the measured files, with the reason, from the names of the sets; `None` if there are none.
pub fn left_out(sources: &Sources<'_>) -> Option<String> {
    let names = sources.sets().filter_map(|set| set.name);
    let said: Vec<&str> = names.filter_map(left_out_of).collect();
    (!said.is_empty()).then(|| said.join("; "))
}

/// The part of a set's name about its missing rows: "row 3: slipped" for `first without row 3: slipped`.
fn left_out_of(name: &str) -> Option<&str> {
    let named = |(at, word): (usize, &str)| {
        let rest = &name[at + word.len()..];
        let (what, why) = rest.split_once(':')?;
        let is_of_points = what.starts_with("row")
            || what.starts_with("point ")
            || what.contains(" points")
            || what.contains("line ");
        let has_number = what.chars().any(|c| c.is_ascii_digit());
        (is_of_points && has_number && !why.trim().is_empty()).then_some(rest)
    };
    name.match_indices(" without ").find_map(named)
}

#[cfg(test)]
mod tests {
    use super::left_out_of;

    #[test]
    fn the_name_of_a_set_says_what_was_left_out_of_it() {
        for (name, said) in [
            ("first without row 3: slipped", Some("row 3: slipped")),
            (
                "a without rows 3, 5 (1 of 20 verify points): bad",
                Some("rows 3, 5 (1 of 20 verify points): bad"),
            ),
            ("a without 14 points: moved", Some("14 points: moved")),
            (
                "a without P42, line 43 (1 of 30 verify points): touched",
                Some("P42, line 43 (1 of 30 verify points): touched"),
            ),
            ("a without line 2: slipped", Some("line 2: slipped")),
            ("a without point P7: slipped", Some("point P7: slipped")),
            ("cell without roof: first", None),
            ("first", None),
        ] {
            assert_eq!(left_out_of(name), said, "{name}");
        }
    }
}
