//! Text about a quick check: the reason for its verdict, and advice what to measure next, with numbers of poses.

use crate::calibration::method::{After, CheckVerdict};
use crate::calibration::quick_check::{DetectableChange, FEW_CAUSES, LikeliestCause};
use crate::calibration::warning::probability_in_words;

/// Equations required per identified parameter. A pose gives three equations. Numbers of poses are multiples of five, and at least ten.
const EQUATIONS_PER_NUMBER: usize = 4;
const STEP: usize = 5;
const MIN_POSES: usize = 10;
/// More poses than this are a calibration, not a check.
const MAX_CHECK_POSES: usize = 40;
/// Number of parameters of a base and of a target.
const BASE: usize = 6;
const TARGET: usize = 3;
/// Number of parameters of a link.
const LINK: usize = 5;

/// The doubt that is stated if nothing else speaks against the set.
pub const ZERO_HIDDEN: &str = "the zero of a joint may have changed that these poses do not show";

/// What a check found.
pub struct Found<'a> {
    /// The verdict.
    pub verdict: CheckVerdict,
    /// What happened to the robot before the check.
    pub after: Option<After>,
    /// The reason why there is no test.
    pub tested: Result<(), &'a str>,
    /// Probability that an unchanged robot has errors as large as these, if there is a test.
    pub probability: Option<f64>,
    /// Why points that fit the set do not prove that it holds.
    pub doubt: Option<&'static str>,
    /// True if the set is far off at the points.
    pub is_far: bool,
    /// Error of the set on the points, rms, mm.
    pub rms_mm: f64,
    /// Its error when it was verified, rms, mm.
    pub verified_rms_mm: Option<f64>,
    /// Likely causes, the likeliest first.
    pub likeliest: &'a [LikeliestCause],
    /// Relevant changes that the poses might not detect.
    pub blind: &'a [&'a DetectableChange],
    /// Joints whose zeros do not show in these poses.
    pub hidden: &'a [&'a DetectableChange],
    /// Largest tool error that the poses may miss, relative to the error that matters. If it is 1 or more, the poses cannot decide.
    pub largest_missed_error_ratio: f64,
    /// Configurations that were measured.
    pub n_configurations: usize,
    /// The configuration that contributes most to the statistic, if one stands out.
    pub largest_configuration: Option<&'a str>,
    /// Number of links.
    pub n_links: usize,
    /// Number of targets.
    pub n_targets: usize,
    /// True if base and targets were fitted anew.
    pub is_placed_anew: bool,
    /// True if the points repeat an earlier upload.
    pub is_repeat: bool,
    /// True if the set has a base that these points do not show.
    pub is_base_hidden: bool,
}

/// The reason for the verdict.
pub fn reason(found: &Found<'_>) -> String {
    let rms_mm = found.rms_mm;
    let verified = found.verified_rms_mm.map_or(String::new(), |verified| {
        format!(", {verified:.4} mm when it was verified")
    });
    let chance = found.probability.map_or(String::new(), |probability| {
        format!(
            "; an unchanged robot shows as much with probability {}",
            probability_in_words(probability)
        )
    });
    let errors = format!("{rms_mm:.4} mm rms on the points{verified}{chance}");
    match found.verdict {
        CheckVerdict::Holds => format!("the released set still holds: {errors}"),
        CheckVerdict::Changed if found.is_far => {
            format!(
                "the released set no longer holds, these points miss it by far: {errors}{}",
                causes(found.likeliest)
            )
        }
        CheckVerdict::Changed => {
            format!(
                "the released set no longer holds: {errors}{}",
                causes(found.likeliest)
            )
        }
        CheckVerdict::CannotTell => match found.tested {
            _ if let Some(why) = found.doubt => {
                format!("it cannot be told whether the released set holds: {why} ({errors})")
            }
            Err(why) => {
                format!("it cannot be told whether the released set holds: {why} ({errors})")
            }
            Ok(()) => {
                let names: Vec<&str> = found.blind.iter().map(|c| c.name.as_str()).collect();
                format!(
                    "the points fit the released set, but these poses might have missed a change that matters of {}: {errors}",
                    names.join(", ")
                )
            }
        },
    }
}

fn causes(likeliest: &[LikeliestCause]) -> String {
    let of = |cause: &LikeliestCause| {
        let unit = if cause.unit == "deg" { "°" } else { " mm" };
        format!(
            "{} by {:.4}{unit} ({:.1} standard deviations)",
            cause.name, cause.delta, cause.sigmas
        )
    };
    let all: Vec<String> = likeliest.iter().take(FEW_CAUSES).map(of).collect();
    match all.as_slice() {
        [] => String::new(),
        [only] => format!(". Likeliest cause: {only}"),
        several => format!(". Likeliest causes, together: {}", several.join(", ")),
    }
}

/// Number of poses for identifying `n_numbers` parameters. If base and targets are unknown, their parameters have to be included.
pub fn poses_for(n_numbers: usize) -> usize {
    let needed = (EQUATIONS_PER_NUMBER * n_numbers).div_ceil(3);
    needed.div_ceil(STEP).max(MIN_POSES / STEP) * STEP
}

/// What to measure next.
pub fn what_next(found: &Found<'_>) -> String {
    let said = match found.verdict {
        CheckVerdict::Holds => holds(found),
        CheckVerdict::CannotTell => cannot_tell(found),
        CheckVerdict::Changed => changed(found),
    };
    match found.hidden {
        [] => said,
        hidden if !found.is_placed_anew => format!(
            "{said}. These poses do not show {}: only a reflector further from the joint's axis does",
            names(hidden)
        ),
        hidden => format!(
            "{said}. In the instrument's frame, base and reflector are placed anew, and these poses do not show {}: to check these too, measure {MIN_POSES} poses in the \
             base frame",
            names(hidden)
        ),
    }
}

fn names(changes: &[&DetectableChange]) -> String {
    let names: Vec<&str> = changes.iter().map(|change| change.name.as_str()).collect();
    names.join(", ")
}

/// Number of base and target parameters, if they have to be identified as well.
fn placement(found: &Found<'_>) -> usize {
    match found.is_placed_anew {
        true => BASE + TARGET * found.n_targets,
        false => 0,
    }
}

fn full(found: &Found<'_>) -> String {
    let n = poses_for(LINK * found.n_links + BASE + TARGET * found.n_targets);
    format!("calibrate anew from {n} poses over the whole workspace (a pose plan chooses them)")
}

fn holds(found: &Found<'_>) -> String {
    match found.after {
        None => "nothing: repeat the check when the next one is due",
        Some(After::Collision) => {
            "nothing: the collision has left no change that these poses could have seen. Repeat the check after some days of work, for a part that works \
             loose"
        }
        Some(After::Mastering) => {
            "nothing: the joints are where they were before, as far as stated here"
        }
        Some(After::Motor) => {
            "nothing: the joint is where it was before, as far as stated here. Repeat the check once the new part has run in"
        }
    }
    .into()
}

fn cannot_tell(found: &Found<'_>) -> String {
    if found.is_repeat {
        return format!("measure {MIN_POSES} poses now, and check with these");
    }
    if found.tested.is_err() {
        return format!(
            "{}, and release the result: it has a stated uncertainty, with which later checks can be told",
            full(found)
        );
    }
    let joints: Vec<&DetectableChange> = found
        .blind
        .iter()
        .copied()
        .filter(|change| change.unit == "deg")
        .collect();
    let moved = match joints.as_slice() {
        [] => "spread over the workspace, with the wrist turned".to_owned(),
        joints => format!(
            "in which the joints of {} move by 90° and more",
            names(joints)
        ),
    };
    if found.blind.is_empty() && found.doubt == Some(ZERO_HIDDEN) {
        return format!(
            "look at the mastering marks of {}; the other joints are where they were",
            names(found.hidden)
        );
    }
    if found.blind.is_empty() {
        let frame = match found.is_base_hidden {
            true => " and in the base frame",
            false => "",
        };
        return format!(
            "measure {MIN_POSES} other poses, {moved}{frame}; or {}",
            full(found)
        );
    }
    // The detectable change decreases with the square root of the number of poses.
    let times = found.largest_missed_error_ratio.max(1.0);
    let n = (found.n_configurations as f64 * times * times).ceil() as usize;
    let n = n.max(found.n_configurations + 1).div_ceil(STEP) * STEP;
    if n > MAX_CHECK_POSES {
        return format!(
            "poses like these would take {n}: measure other ones, {MIN_POSES} {moved}, in the base frame if there is one; or {}",
            full(found)
        );
    }
    format!("measure about {n} new poses in a file of their own, {moved}")
}

fn changed(found: &Found<'_>) -> String {
    let first = match found.after {
        Some(After::Collision) => {
            "First look whether tool, reflector and mastering marks are where they should be. Then: "
        }
        Some(After::Mastering) => "First look whether every joint was mastered at its mark. Then: ",
        Some(After::Motor) => {
            "First master the joint whose motor was exchanged, if nobody did. Then: "
        }
        None => "",
    };
    let again = found.largest_configuration.map_or(String::new(), |label| {
        format!(
            ". Most of it is of configuration {label}: measure that one again, a broken beam looks the same"
        )
    });
    let [cause] = found.likeliest else {
        return format!("{first}{}{again}", full(found));
    };
    let step = if cause.name.starts_with("base") {
        format!(
            "set the base frame up anew, or look whether instrument or robot was moved, and check again with {MIN_POSES} poses"
        )
    } else if cause.name.starts_with("target") {
        format!(
            "look whether the reflector sits where it did, and check again with {MIN_POSES} poses. If the tool was changed, calibrate it from {} poses with the \
             wrist turned",
            poses_for(TARGET + placement(found))
        )
    } else {
        let one = cause.name.split(' ').next().unwrap_or(&cause.name);
        format!(
            "measure {} poses over the workspace and identify {one} alone, with the rest held at the parameter set; if the \
             result does not verify, {}",
            poses_for(1 + placement(found)),
            full(found)
        )
    };
    format!("{first}{step}{again}")
}
