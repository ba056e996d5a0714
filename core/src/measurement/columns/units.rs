//! Units in headers and cells.

/// Rates of cameras, Hz.
const MIN_RATE_HZ: f64 = 0.1;
const MAX_RATE_HZ: f64 = 1.0e6;

/// Unit of a column of times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeUnit {
    /// No unit is stated. Times of day and dates can be read, plain numbers cannot.
    Unstated,
    /// Seconds.
    Seconds,
    /// Milliseconds.
    Milliseconds,
    /// Microseconds.
    Microseconds,
    /// Frames of a camera, with their number in a thousand seconds.
    Frames(u32),
}

impl TimeUnit {
    /// Name of the unit.
    pub fn name(self) -> Option<String> {
        match self {
            Self::Unstated => None,
            Self::Seconds => Some("s".into()),
            Self::Milliseconds => Some("ms".into()),
            Self::Microseconds => Some("us".into()),
            Self::Frames(millihertz) => Some(format!("{}hz", f64::from(millihertz) / 1e3)),
        }
    }

    /// Frames at this rate, if it can be that of a camera: 120 for `120hz`.
    pub fn of_rate(hertz: &str) -> Option<Self> {
        let rate: f64 = hertz.trim().parse().ok()?;
        (MIN_RATE_HZ..=MAX_RATE_HZ)
            .contains(&rate)
            .then(|| Self::Frames((rate * 1e3).round() as u32))
    }

    /// Number of seconds in one unit.
    pub fn seconds(self) -> f64 {
        match self {
            Self::Unstated | Self::Seconds => 1.0,
            Self::Milliseconds => 1.0e-3,
            Self::Microseconds => 1.0e-6,
            Self::Frames(millihertz) => 1.0e3 / f64::from(millihertz),
        }
    }
}

/// The unit in a header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// No unit is stated.
    Missing,
    /// An ambiguous unit: German `Grad` means degree, English `grad` means gon.
    TwoReadings,
    /// This unit, as written in kincal's file format.
    Is(&'static str),
}

/// Units of length, with the number of mm in one unit.
pub const LENGTHS: [(&str, f64); 5] = [
    ("mm", 1.0),
    ("m", 1000.0),
    ("cm", 10.0),
    ("um", 0.001),
    ("in", 25.4),
];

/// Units of joint values, with the number of rad in one unit. A turn has 400 gon.
pub const ANGLES: [(&str, f64); 3] = [
    ("deg", std::f64::consts::PI / 180.0),
    ("rad", 1.0),
    ("gon", std::f64::consts::PI / 200.0),
];

/// Whether a unit is one of angles.
pub fn is_angle(unit: Unit) -> bool {
    ANGLES.iter().any(|(name, _)| unit == Unit::Is(name))
}

pub fn unit_of(text: &str) -> Option<Unit> {
    Some(Unit::Is(match text.trim_end_matches('.') {
        "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" | "毫米" => "mm",
        "m" | "meter" | "meters" | "metre" | "metres" => "m",
        "cm" | "centimeter" | "centimeters" | "centimetre" | "centimetres" => "cm",
        "um" | "micrometer" | "micrometers" | "micron" | "microns" => "um",
        "in" | "inch" | "inches" => "in",
        "deg" | "degree" | "degrees" | "degs" | "gradi" | "grados" | "degré" | "degrés" | "度" => {
            "deg"
        }
        "rad" | "radian" | "radians" | "rads" | "弧度" => "rad",
        "s" | "sec" | "secs" | "second" | "seconds" => "s",
        "ms" | "milliseconds" => "ms",
        "us" | "microseconds" => "us",
        "gon" | "gons" => "gon",
        "grad" | "grads" => return Some(Unit::TwoReadings),
        _ => return None,
    }))
}

/// The unit in a cell that contains nothing but a unit. Used for a row of units below the header.
pub fn unit_alone(cell: &str) -> Option<Unit> {
    let plain = simplified(cell);
    unit_of(plain.trim_matches(|c: char| "[](){}（）［］ ".contains(c)))
}

/// Lower case, with `°` replaced by `deg` and `µ` by `u`.
pub fn simplified(text: &str) -> String {
    let text = text.trim().to_lowercase();
    text.replace(['°', 'º', '˚'], "deg")
        .replace(['µ', 'μ'], "u")
}

/// The name in a header in small letters, without its unit, and the unit.
pub fn name_and_unit(header: &str) -> (String, Option<Unit>) {
    without_unit(&simplified(header))
}

/// Splits a name into the name without unit and the unit. The unit is in brackets or is the last word.
pub fn without_unit(text: &str) -> (String, Option<Unit>) {
    for (open, close) in [
        ('[', ']'),
        ('(', ')'),
        ('{', '}'),
        ('<', '>'),
        ('（', '）'),
        ('［', '］'),
    ] {
        let Some(inner) = text.strip_suffix(close) else {
            continue;
        };
        let Some((base, unit)) = inner.rsplit_once(open) else {
            continue;
        };
        if let Some(unit) = unit_of(unit.trim()) {
            return (base.into(), Some(unit));
        }
    }
    // `J1deg`, which also results from `J1°`.
    let short = text.strip_suffix("deg");
    if let Some(base) = short.filter(|base| base.ends_with(|c: char| c.is_ascii_digit())) {
        return (base.into(), Some(Unit::Is("deg")));
    }
    if let Some((base, unit)) = text.rsplit_once(|c: char| " _/,.-:".contains(c)) {
        // "in" as the last word is not accepted as a unit: "x in" may mean inches or may be the beginning of "x in mm".
        let unit = unit_of(unit).filter(|unit| *unit != Unit::Is("in"));
        if let Some(unit) = unit.filter(|_| !base.trim().is_empty()) {
            let base = base.trim_end_matches(|c: char| " _/,.-:".contains(c));
            return (base.strip_suffix(" in").unwrap_or(base).into(), Some(unit));
        }
    }
    (text.into(), None)
}
