//! Recognises the common names of columns. This module does not decide about names with two meanings, or names without a required unit.

use crate::measurement::columns::units::{is_angle, simplified, unit_of, without_unit};
use crate::measurement::columns::words::is_one_of;
use std::collections::BTreeSet;

pub use crate::measurement::columns::units::{
    ANGLES, LENGTHS, TimeUnit, Unit, name_and_unit, unit_alone,
};

/// The meaning of a header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Known {
    /// A joint value, with the number in the name and the unit.
    Joint(usize, Unit),
    /// A coordinate, 0 to 2 for x to z, with its unit.
    Position(usize, Unit),
    /// A column of [`PLAIN`], or `sweep_joint`, under exactly this name (ignoring letter case).
    Plain(String),
    /// A name of kincal's file format with a unit that this format does not allow.
    WrongUnit,
    /// Join key: pairs the rows of two files.
    Key(Key),
    /// An unknown name.
    Unknown,
}

/// Join key: pairs the rows of two files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// Name of a point.
    Name,
    /// Number of a point.
    Number,
    /// Time of the row, with the unit of the column.
    Time(TimeUnit),
    /// Group of points to which the row belongs, such as `Measured`.
    Group,
    /// Collection of such groups.
    Collection,
}

impl Key {
    /// Whether a column of this key says which point a row is.
    pub fn is_label(self) -> bool {
        !matches!(self, Self::Group | Self::Collection)
    }
}

/// Columns with fixed names. The name includes the unit if the column has one.
pub const PLAIN: [&str; 31] = [
    "configuration",
    "target",
    "target_name",
    "subset",
    "measured_at",
    "std_mm",
    "station",
    "session",
    "sequence",
    "temperature_c",
    "kind",
    "quat_w",
    "quat_x",
    "quat_y",
    "quat_z",
    "rx_deg",
    "ry_deg",
    "rz_deg",
    "std_x_mm",
    "std_y_mm",
    "std_z_mm",
    "std_rotation_deg",
    "std_rx_deg",
    "std_ry_deg",
    "std_rz_deg",
    "cov_xx_mm2",
    "cov_xy_mm2",
    "cov_xz_mm2",
    "cov_yy_mm2",
    "cov_yz_mm2",
    "cov_zz_mm2",
];

/// The meaning of a header. `below` is the unit below the header, if there is a row of units.
pub fn recognise(header: &str, below: Option<Unit>) -> Known {
    let text = simplified(header);
    if PLAIN.contains(&text.as_str()) || text == "sweep_joint" {
        return Known::Plain(text);
    }
    if let Some(known) = own_form(&text) {
        return known;
    }
    // Field of the RTDE interface of Universal Robots. It is defined to be in radians.
    if let Some(number) = text.strip_prefix("actual_q_").and_then(|n| n.parse().ok())
        && below.is_none()
    {
        return Known::Joint(number, Unit::Is("rad"));
    }
    // Variables of KUKA. They are defined to be in degrees.
    let of_kuka = ["$axis_act.a", "$axis_act_meas.a"];
    let number = of_kuka.iter().find_map(|name| text.strip_prefix(name));
    if let Some(number) = number.and_then(|n| n.parse().ok())
        && below.is_none()
    {
        return Known::Joint(number, Unit::Is("deg"));
    }
    let (base, unit) = without_unit(&text);
    let unit = match unit {
        // In a German name `Grad` means degrees.
        Some(Unit::TwoReadings) if is_german(&base) && text.contains("grad") => {
            Some(Unit::Is("deg"))
        }
        unit => unit,
    };
    let unit = match (unit, below) {
        (Some(unit), Some(other)) if unit != other => Unit::TwoReadings,
        (Some(unit), _) | (None, Some(unit)) => unit,
        (None, None) => Unit::Missing,
    };
    let words = words(&base);
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    joint(&words, unit)
        .or_else(|| position(&words, unit))
        .or_else(|| position_in_two_units(&words, unit, below))
        .or_else(|| key(&words, unit))
        .unwrap_or(Known::Unknown)
}

/// Whether a name has a German word for a joint.
fn is_german(base: &str) -> bool {
    let of_joint = ["achse", "gelenk", "winkel"];
    of_joint.iter().any(|word| base.contains(word))
}

/// Recognises `q1_deg` and `x_mm` as written in kincal's file format, ignoring letter case. Other units in this notation are refused.
fn own_form(text: &str) -> Option<Known> {
    let (base, unit) = text.split_once('_')?;
    let known = unit_of(unit)?;
    if let Some(axis) = ["x", "y", "z"].iter().position(|name| *name == base) {
        return Some(match known {
            Unit::Is("mm" | "m") if unit.len() <= 2 => Known::Position(axis, known),
            _ => Known::WrongUnit,
        });
    }
    let digits = base.strip_prefix('q')?;
    let number: usize = digits.parse().ok().filter(|_| digits.len() <= 3)?;
    Some(match known {
        known if is_angle(known) && unit.len() == 3 => Known::Joint(number, known),
        _ => Known::WrongUnit,
    })
}

/// Splits a name into words and numbers: `Joint_1`, `joint1` and `joint[1]` give the same two parts.
fn words(text: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut before = ' ';
    for c in text.chars() {
        let continues = before.is_alphabetic() && c.is_alphabetic()
            || before.is_ascii_digit() && c.is_ascii_digit();
        match words.last_mut().filter(|_| continues) {
            Some(word) => word.push(c),
            None if c.is_alphanumeric() || c == '#' => words.push(c.into()),
            None => {}
        }
        before = c;
    }
    words
}

/// Words next to the name of a joint that do not change its meaning.
const IGNORED_JOINT_WORDS: &str = "angle|angolo|pos|position|value|winkel|actual|act|ist";

fn joint(words: &[&str], unit: Unit) -> Option<Known> {
    let angle = is_angle(unit) || matches!(unit, Unit::Missing | Unit::TwoReadings);
    let is_base = |word: &&str| {
        matches!(
            *word,
            "q" | "j"
                | "a"
                | "joint"
                | "axis"
                | "ax"
                | "achse"
                | "axe"
                | "asse"
                | "gelenk"
                | "jt"
                | "jpos"
                | "rax"
                | "theta"
                | "θ"
                | "ϑ"
        )
    };
    let rest: Vec<&str> = words
        .iter()
        .copied()
        .filter(|word| !is_one_of(IGNORED_JOINT_WORDS, word))
        .collect();
    let is_angular = |word: &&str| matches!(*word, "angle" | "winkel" | "angolo");
    let (is_joint, number) = match rest[..] {
        [base, number] => (is_base(&base), number),
        // `$AXIS_ACT.A1`
        ["axis" | "joint", "a", number] => (true, number),
        [number] => (words.iter().any(is_angular), number),
        _ => return None,
    };
    let number: usize = number.parse().ok().filter(|_| number.len() <= 3)?;
    (angle && is_joint).then_some(Known::Joint(number, unit))
}

/// Words next to the name of a coordinate that do not change its meaning. `tcp`, `nominal` and `target` are not among them, because such columns are
/// not measurements.
const IGNORED_POSITION_WORDS: &str = "pos|position|coord|coordinate|koordinate|meas|measured|measurement|tracker|smr|reflector|\
    actual|ist|laser|value";

fn position(words: &[&str], unit: Unit) -> Option<Known> {
    let length =
        matches!(unit, Unit::Missing) || LENGTHS.iter().any(|(name, _)| unit == Unit::Is(name));
    let rest: Vec<&str> = words
        .iter()
        .copied()
        .filter(|word| !is_one_of(IGNORED_POSITION_WORDS, word))
        .collect();
    let axis = match rest[..] {
        ["x" | "px" | "posx"] => 0,
        ["y" | "py" | "posy"] => 1,
        ["z" | "pz" | "posz"] => 2,
        // Without a unit it may be a torque.
        ["tx"] if unit != Unit::Missing => 0,
        ["ty"] if unit != Unit::Missing => 1,
        ["tz"] if unit != Unit::Missing => 2,
        _ => return None,
    };
    length.then_some(Known::Position(axis, unit))
}

/// Recognises a coordinate with one unit in its name and another one in the row of units below.
fn position_in_two_units(words: &[&str], unit: Unit, below: Option<Unit>) -> Option<Known> {
    let is_told_twice = unit == Unit::TwoReadings && below.is_some_and(|unit| !is_angle(unit));
    match position(words, Unit::Missing).filter(|_| is_told_twice)? {
        Known::Position(axis, _) => Some(Known::Position(axis, unit)),
        _ => None,
    }
}

fn key(words: &[&str], unit: Unit) -> Option<Known> {
    let key = match words {
        [
            "name" | "point" | "pointname" | "pointid" | "pt" | "ptid" | "label" | "punkt" | "pkt"
            | "punktname" | "pose",
        ]
        | [
            "point" | "pt" | "punkt" | "pkt" | "target",
            "name" | "id" | "label",
        ]
        | ["object", "name"]
        | ["collection", "group", "target" | "point"] => Key::Name,
        ["group" | "gruppe"] | ["point", "group"] | ["group", "name"] => Key::Group,
        ["collection"] | ["collection", "name"] => Key::Collection,
        ["no" | "nr" | "number" | "num" | "index" | "idx" | "nummer" | "#" | "id"]
        | [
            "point" | "pt" | "punkt" | "pkt" | "pose" | "row",
            "no" | "nr" | "number" | "index" | "#",
        ] => Key::Number,
        ["time" | "timestamp" | "t" | "zeit" | "datetime" | "uhrzeit"]
        | ["time", "stamp"]
        | ["date", "time"] => Key::Time(match unit {
            Unit::Is("ms") => TimeUnit::Milliseconds,
            Unit::Is("us") => TimeUnit::Microseconds,
            Unit::Missing => TimeUnit::Unstated,
            Unit::Is("s") => TimeUnit::Seconds,
            _ => return None,
        }),
        _ => return None,
    };
    Some(Known::Key(key))
}

/// The known column whose name differs from this header by one letter. So a typing error is reported, and the column is not ignored as
/// unknown.
pub fn nearly(header: &str) -> Option<&'static str> {
    let text = simplified(header);
    PLAIN.into_iter().find(|name| differs_by_one(name, &text))
}

fn differs_by_one(a: &str, b: &str) -> bool {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    if a == b || a.len().abs_diff(b.len()) > 1 {
        return false;
    }
    let same_start = a.iter().zip(&b).take_while(|(x, y)| x == y).count();
    let same_end = a
        .iter()
        .rev()
        .zip(b.iter().rev())
        .take_while(|(x, y)| x == y)
        .count();
    let longest = a.len().max(b.len());
    same_start + same_end + 1 >= longest
}

/// Names of axes, without spaces, of makers that do not number them: Yaskawa, and Universal Robots on its pendant and in ROS.
const NAMED_AXES: [[&str; 6]; 3] = [
    ["s", "l", "u", "r", "b", "t"],
    ["base", "shoulder", "elbow", "wrist1", "wrist2", "wrist3"],
    [
        "shoulderpan",
        "shoulderlift",
        "elbow",
        "wrist1",
        "wrist2",
        "wrist3",
    ],
];

/// The six axes of a maker with named axes, as (place, axis counted from 1, unit), if a table has exactly one column for each. A single
/// such name has no meaning.
pub fn named_axes(
    names: &[(&str, Option<Unit>)],
    taken: &BTreeSet<usize>,
    n_joints: usize,
) -> Vec<(usize, usize, Unit)> {
    let axes_of = |maker: [&str; 6]| -> Vec<(usize, usize, Unit)> {
        let axis = |(place, (name, below)): (usize, &(&str, Option<Unit>))| {
            let (base, unit) = without_unit(&simplified(name));
            let base = base.replace([' ', '_'], "");
            let base = base.strip_suffix("joint").unwrap_or(&base);
            let axis = maker.iter().position(|name| *name == base)?;
            let unit = unit.or(*below).unwrap_or(Unit::Missing);
            let is_known = is_angle(unit) || matches!(unit, Unit::Missing | Unit::TwoReadings);
            (is_known && !taken.contains(&place)).then_some((place, axis + 1, unit))
        };
        names.iter().enumerate().filter_map(axis).collect()
    };
    let is_whole = |axes: &Vec<(usize, usize, Unit)>| {
        let numbers: BTreeSet<usize> = axes.iter().map(|(_, axis, _)| *axis).collect();
        axes.len() == 6 && numbers.len() == 6
    };
    let found = NAMED_AXES.into_iter().map(axes_of).find(is_whole);
    found.filter(|_| n_joints == 6).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::{Key, Known, TimeUnit, Unit, nearly, recognise};

    #[test]
    fn common_names_mean_what_they_say() {
        let deg = Unit::Is("deg");
        for name in [
            "q3_deg",
            "Q3_DEG",
            "J3 [deg]",
            "J3 (°)",
            "A3 [°]",
            "Axis 3 [deg]",
            "Joint3_deg",
            "joint_3 deg",
            "Joint[3] (deg)",
            "J3°",
            "RAX_3 [deg]",
            "Achse 3 in deg",
            "JT3, deg",
            "Joint 3 angle [degrees]",
            "Achse 3 [Grad]",
            "Winkel 3 [°]",
            "Angle 3 [deg]",
            "Axe 3 [°]",
            "Asse 3 (gradi)",
            "theta3 (deg)",
            "θ3 [Deg.]",
            "J3（°）",
            "J3（度）",
            "$AXIS_ACT.A3",
            "$AXIS_ACT.A3 [°]",
        ] {
            assert_eq!(recognise(name, None), Known::Joint(3, deg), "{name}");
        }
        let mm = Unit::Is("mm");
        for name in [
            "x_mm",
            "X (mm)",
            "X [mm]",
            "X mm",
            "X/mm",
            "x in mm",
            "Pos X [mm]",
            "Measured X [millimeters]",
            "pos_x_mm",
        ] {
            assert_eq!(recognise(name, None), Known::Position(0, mm), "{name}");
        }
        assert_eq!(
            recognise("actual_q_0", None),
            Known::Joint(0, Unit::Is("rad"))
        );
        assert_eq!(
            recognise("actual q 0", None),
            Known::Joint(0, Unit::Missing)
        );
        assert_eq!(
            recognise("Z", Some(Unit::Is("m"))),
            Known::Position(2, Unit::Is("m"))
        );
        assert_eq!(recognise("Point Name", None), Known::Key(Key::Name));
        assert_eq!(
            recognise("time [ms]", None),
            Known::Key(Key::Time(TimeUnit::Milliseconds))
        );
    }

    #[test]
    fn what_a_name_does_not_say_is_not_known() {
        assert_eq!(recognise("J1", None), Known::Joint(1, Unit::Missing));
        assert_eq!(
            recognise("A2 [Grad]", None),
            Known::Joint(2, Unit::TwoReadings)
        );
        assert_eq!(
            recognise("Achse 2 [gon]", None),
            Known::Joint(2, Unit::Is("gon"))
        );
        assert_eq!(recognise("Asse 2", None), Known::Joint(2, Unit::Missing));
        assert_eq!(recognise("x_um", None), Known::WrongUnit);
        assert_eq!(recognise("q1_inch", None), Known::WrongUnit);
        for name in [
            "TCP X [mm]",
            "Nominal X [mm]",
            "dX [mm]",
            "J1 cmd [deg]",
            "E1",
            "A1 [mm]",
            "x [deg]",
            "colour",
            "RX [deg]",
            "",
        ] {
            assert_eq!(recognise(name, None), Known::Unknown, "{name}");
        }
    }

    #[test]
    fn a_slip_of_the_keyboard_is_found() {
        assert_eq!(nearly("std_m"), Some("std_mm"));
        assert_eq!(nearly("Sesion"), Some("session"));
        assert_eq!(nearly("station"), None);
        assert_eq!(nearly("stdev"), None);
    }
}
