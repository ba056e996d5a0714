//! A program with joint or Cartesian targets, as a table. Reads it, and writes it with corrected targets; all other bytes stay unchanged.

use crate::measurement::Decimal;
use crate::measurement::columns::mapping::Separator;
use crate::measurement::columns::pose::ROTATION_REQUIRED;
use crate::measurement::csv::number_text::value;
use crate::measurement::programs;
use crate::measurement::rotation_convention::{CONVENTIONS, RotationConvention};
use crate::measurement::table::targets::{Targets, read_targets};
use crate::measurement::table::text::{Encoding, Source, encoded, has_mark};
use crate::wire::columns::{ColumnsBody, FilePart};
use crate::wire::compensate::{
    CartesianTarget, CompensateAnswer, CompensateBody, MAX_TARGETS_PER_REQUEST,
};
use crate::wire::decimals::fixed;
use crate::wire::issue::{Invalid, Issue};
use crate::wire::{table_upload, workbook};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::ops::Range;

/// A target of a program.
#[derive(Clone, Debug)]
pub enum ProgramTarget {
    /// Joint values, degrees.
    Joints(Vec<f64>),
    /// A position or pose with joint values near it.
    Cartesian(CartesianTarget),
}

/// The components of a program's Cartesian targets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Poses {
    /// None: the targets are joint values.
    None,
    /// Positions only.
    Positions,
    /// Positions and quaternions.
    Quaternions,
    /// Positions and three angles.
    Angles,
}

/// A target, and the places of its numbers in the text.
#[derive(Clone, Debug)]
struct Place {
    target: ProgramTarget,
    /// The line of the program on which it begins, counted from 1.
    line: usize,
    joints: Vec<Range<usize>>,
    position: Option<[Range<usize>; 3]>,
    quaternion: Option<[Range<usize>; 4]>,
    angles: Option<Angles>,
}

/// Three angles of a Cartesian target.
#[derive(Clone, Debug)]
struct Angles {
    places: [Range<usize>; 3],
    convention: RotationConvention,
    /// The angles in the program.
    angles_rad: Vector3<f64>,
}

/// A program.
#[derive(Clone, Debug)]
pub struct Program {
    text: String,
    encoding: Encoding,
    has_mark: bool,
    places: Vec<Place>,
    /// Degrees in one unit of the joint values.
    deg: f64,
    decimal: Decimal,
    separator: Separator,
    /// The name of each joint's column.
    pub joints: Vec<String>,
    /// Names of columns with poses of the joint values. They stay as they are.
    pub other_poses: Vec<String>,
    /// True if it was a workbook: it is written as text with tabs between its columns.
    pub is_workbook: bool,
}

impl Program {
    /// Reads a program. `columns` states the meaning of columns whose names do not show it, and `rotation` is the convention of the angles
    /// of Cartesian targets.
    ///
    /// # Errors
    /// [`Invalid`] with the line and column of each error, for a table without joint targets, for angles without a convention, and for a
    /// robot program, because its text does not say which of its points are targets and of which tool.
    pub fn parse(
        bytes: &[u8],
        columns: &ColumnsBody,
        rotation: Option<RotationConvention>,
    ) -> Result<Self, Invalid> {
        let mut mapping = columns.mapping(FilePart::Robot)?;
        let kind = workbook::workbook(bytes);
        let source = match kind {
            Some(kind) => {
                let (source, sheet) = workbook::read(kind, bytes, &mapping)?;
                mapping.sheet = Some(sheet);
                source
            }
            None => Source::decode(bytes).map_err(|e| table_upload::table_error(&e))?,
        };
        if kind.is_none() && programs::find(&source.text).map_or(true, |found| found.is_some()) {
            let detail = "a robot program is not corrected in place: which of its points are targets, and of which tool, its text does not say. Write the joint \
                          values of its targets as a table with the columns q1_deg, q2_deg and so on, and correct that";
            return Err(Invalid::at("", "robot_program", detail));
        }
        let stated = columns.mapping(FilePart::Table)?;
        let targets = read_targets(&source, &mapping, &stated.columns);
        let targets = targets.map_err(|error| table_upload::table_error(&error))?;
        let program = Self::of_table(source, has_mark(bytes), targets, rotation)?;
        Ok(Self {
            is_workbook: kind.is_some(),
            ..program
        })
    }

    fn of_table(
        source: Source,
        has_mark: bool,
        targets: Targets,
        rotation: Option<RotationConvention>,
    ) -> Result<Self, Invalid> {
        let convention = convention_of_angles(&targets, rotation)?;
        let text = source.text.into_owned();
        let joints = &targets.joints;
        let deg = joints.first().map_or(1.0, |joint| joint.deg);
        let names: Vec<String> = joints.iter().map(|joint| joint.name.clone()).collect();
        let rows = targets.rows.into_iter().map(|row| {
            let cell = |column: usize| row.cells.get(column).cloned().unwrap_or_default();
            let number = |place: &Range<usize>| {
                let cell = &text[place.clone()];
                value(cell, targets.decimal).ok_or_else(|| {
                    let issue = Issue {
                        line: Some(row.line),
                        code: "not_a_number".into(),
                        detail: format!("line {}: {cell:?} is not a number", row.line),
                        ..Issue::default()
                    };
                    Invalid {
                        code: "invalid_measurements",
                        issues: vec![issue],
                    }
                })
            };
            let position = targets.position.map(|columns| columns.map(cell));
            let quaternion = targets.quaternion.filter(|_| position.is_some());
            let quaternion = quaternion.map(|columns| columns.map(cell));
            let angles = match (targets.angles, convention) {
                (Some(columns), Some(convention)) => {
                    let places = columns.map(cell);
                    let angles_deg = numbers(&places, number)?;
                    Some(Angles {
                        places,
                        convention,
                        angles_rad: Vector3::from(angles_deg.map(f64::to_radians)),
                    })
                }
                _ => None,
            };
            let target = match &position {
                None => ProgramTarget::Joints(row.q_deg),
                Some(position) => ProgramTarget::Cartesian(CartesianTarget {
                    position_mm: numbers(position, number)?,
                    quaternion: match &quaternion {
                        Some(quaternion) => Some(numbers(quaternion, number)?),
                        None => None,
                    },
                    rotation: angles.as_ref().map(|angles| {
                        let rotation = angles.convention.rotation(&angles.angles_rad);
                        rotation.matrix().transpose().into()
                    }),
                    q_near_deg: row.q_deg,
                }),
            };
            Ok(Place {
                target,
                line: row.line,
                joints: joints.iter().map(|joint| cell(joint.place)).collect(),
                position,
                quaternion,
                angles,
            })
        });
        Ok(Self {
            places: rows.collect::<Result<_, Invalid>>()?,
            encoding: source.encoding,
            has_mark,
            deg,
            decimal: targets.decimal,
            separator: targets.separator,
            joints: names,
            other_poses: targets.other_poses,
            is_workbook: false,
            text,
        })
    }

    /// The program for a robot of `n` joints. Values of further joints, such as those of a rail, stay unchanged.
    pub fn of_joints(mut self, n: usize) -> Self {
        self.joints.truncate(n);
        for place in &mut self.places {
            place.joints.truncate(n);
            match &mut place.target {
                ProgramTarget::Joints(q_deg) => q_deg.truncate(n),
                ProgramTarget::Cartesian(target) => target.q_near_deg.truncate(n),
            }
        }
        self
    }

    /// The targets in their order.
    pub fn targets(&self) -> Vec<ProgramTarget> {
        let places = self.places.iter();
        places.map(|place| place.target.clone()).collect()
    }

    /// The components of its Cartesian targets.
    pub fn poses(&self) -> Poses {
        match self.places.first() {
            Some(place) if place.quaternion.is_some() => Poses::Quaternions,
            Some(place) if place.angles.is_some() => Poses::Angles,
            Some(place) if place.position.is_some() => Poses::Positions,
            _ => Poses::None,
        }
    }

    /// The line of each target, counted from 1.
    pub fn lines(&self) -> Vec<usize> {
        self.places.iter().map(|place| place.line).collect()
    }

    /// Requests like `body` for the targets of this program, each with the number of its first target. A long program needs several.
    pub fn requests(&self, body: &CompensateBody) -> Vec<(usize, CompensateBody)> {
        let parts = self.places.chunks(MAX_TARGETS_PER_REQUEST).enumerate();
        let request = |(i, part): (usize, &[Place])| {
            let mut body = body.clone();
            for place in part {
                match &place.target {
                    ProgramTarget::Joints(q_deg) => body.q_deg.push(q_deg.clone()),
                    ProgramTarget::Cartesian(target) => body.targets.push(target.clone()),
                }
            }
            (i * MAX_TARGETS_PER_REQUEST, body)
        };
        parts.map(request).collect()
    }

    /// Converts the issues of a request for these targets: pointers become lines and columns of the program. `first` is the first target of
    /// the request.
    pub fn placed(&self, issues: &[Issue], first: usize) -> Vec<Issue> {
        let mut placed: Vec<Issue> = issues
            .iter()
            .map(|issue| self.placed_one(issue, first))
            .collect();
        // An error of a whole column is reported once per row; one is kept.
        placed.dedup();
        placed
    }

    fn placed_one(&self, issue: &Issue, first: usize) -> Issue {
        let pointer = issue.pointer.as_deref().unwrap_or_default();
        let mut pointer = pointer.split('/').skip(1);
        let (field, row, joint) = (pointer.next(), pointer.next(), pointer.next());
        let row = row.and_then(|row| Some(first + row.parse::<usize>().ok()?));
        let place = row.and_then(|row| self.places.get(row));
        let joint = joint.and_then(|joint| joint.parse::<usize>().ok());
        let of_row = |place: &Place, column: Option<String>, at: String| Issue {
            row: None,
            line: Some(place.line),
            column,
            pointer: None,
            detail: format!("line {}{at}: {}", place.line, issue.detail),
            ..issue.clone()
        };
        match (field, place, joint) {
            (Some("q_deg"), Some(place), Some(joint)) => match self.joints.get(joint) {
                Some(name) => of_row(place, Some(name.clone()), format!(", column {name}")),
                None => of_row(place, None, format!(", joint {}", joint + 1)),
            },
            (Some("targets"), Some(place), _) => of_row(place, None, String::new()),
            (Some("q_deg"), ..) => {
                let n = self.places.first().map_or(0, |place| place.joints.len());
                Issue {
                    pointer: None,
                    detail: format!(
                        "the program has joint values of {n} joints: {}",
                        issue.detail
                    ),
                    ..issue.clone()
                }
            }
            _ => issue.clone(),
        }
    }

    /// The program with corrected targets, in its own encoding.
    pub fn with(&self, answer: &CompensateAnswer) -> Vec<u8> {
        let mut replaced: Vec<(&Range<usize>, String)> = Vec::new();
        for (i, (place, q_deg)) in self.places.iter().zip(&answer.q_deg).enumerate() {
            let angles = place.joints.iter().zip(q_deg);
            replaced.extend(angles.map(|(at, q_deg)| (at, self.angle(at, *q_deg))));
            if let Some(pose) = answer.poses.as_ref().and_then(|poses| poses.get(i)) {
                let position = place.position.iter().flatten().zip(pose.position_mm);
                replaced.extend(position.map(|(at, mm)| (at, self.marked(at, fixed(mm, 5)))));
                let quaternion = place.quaternion.iter().flatten().zip(pose.quaternion);
                replaced.extend(quaternion.map(|(at, q)| (at, self.marked(at, fixed(q, 9)))));
                if let Some(angles) = &place.angles {
                    let [w, x, y, z] = pose.quaternion;
                    let q = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
                    let rotation = q.to_rotation_matrix();
                    let rad = angles.convention.angles_rad(&rotation, &angles.angles_rad);
                    let angles = angles.places.iter().zip(rad.iter());
                    replaced.extend(
                        angles.map(|(at, rad)| (at, self.marked(at, fixed(rad.to_degrees(), 7)))),
                    );
                }
            }
        }
        replaced.sort_by_key(|(at, _)| at.start);
        let mut text = String::with_capacity(self.text.len() + 8 * replaced.len());
        let mut from = 0;
        for (at, number) in replaced {
            text.push_str(&self.text[from..at.start]);
            text.push_str(&number);
            from = at.end;
        }
        text.push_str(&self.text[from..]);
        encoded(&text, self.encoding, self.has_mark)
    }

    fn angle(&self, at: &Range<usize>, q_deg: f64) -> String {
        self.marked(
            at,
            // The step is at most 2e-7 degrees in each unit.
            match self.deg > 10.0 {
                true => fixed(q_deg / self.deg, 9),
                false => fixed(q_deg / self.deg, 7),
            },
        )
    }

    /// A number with the program's decimal mark. It is quoted if the separator of the columns is the same character.
    fn marked(&self, at: &Range<usize>, number: String) -> String {
        let number = match self.decimal {
            Decimal::Point => return number,
            Decimal::Comma => number.replace('.', ","),
        };
        match self.separator == Separator::Comma && !self.text[..at.start].ends_with('"') {
            true => format!("\"{number}\""),
            false => number,
        }
    }
}

/// The convention of the angles of Cartesian targets. It is never guessed.
fn convention_of_angles(
    targets: &Targets,
    rotation: Option<RotationConvention>,
) -> Result<Option<RotationConvention>, Invalid> {
    let refused = |code, detail| Err(Invalid::at("/rotation", code, detail));
    let is_cartesian = targets.position.is_some();
    match (targets.angles, targets.quaternion, rotation) {
        (Some(_), Some(_), _) if is_cartesian => refused(
            "duplicate_column",
            "a target has a quaternion or the angles rx_deg, ry_deg and rz_deg, not both".into(),
        ),
        (Some(_), _, None) if is_cartesian => refused(
            ROTATION_REQUIRED,
            format!(
                "rx_deg, ry_deg and rz_deg are a rotation only with a convention: say rotation={CONVENTIONS}. Nothing is guessed"
            ),
        ),
        (Some(_), _, Some(convention)) if is_cartesian => Ok(Some(convention)),
        (.., None) => Ok(None),
        (.., Some(_)) => refused(
            "missing_column",
            "a convention of rotations is stated, and the program has no Cartesian targets with rx_deg, ry_deg and rz_deg: leave it out".into(),
        ),
    }
}

fn numbers<const N: usize>(
    places: &[Range<usize>; N],
    number: impl Fn(&Range<usize>) -> Result<f64, Invalid>,
) -> Result<[f64; N], Invalid> {
    let mut found = [0.0; N];
    for (found, place) in found.iter_mut().zip(places) {
        *found = number(place)?;
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::{Program, ProgramTarget};
    use crate::wire::Invalid;
    use crate::wire::columns::ColumnsBody;
    use crate::wire::compensate::CompensateAnswer;

    fn parse(bytes: &[u8], columns: &str) -> Result<Program, Invalid> {
        let columns = ColumnsBody::parse(columns.as_bytes()).unwrap();
        Program::parse(bytes, &columns, None)
    }

    fn q_deg(program: &Program) -> Vec<Vec<f64>> {
        let targets = program.targets().into_iter();
        let targets = targets.map(|target| match target {
            ProgramTarget::Joints(q_deg) => q_deg,
            ProgramTarget::Cartesian(target) => target.q_near_deg,
        });
        let rounded = |q: f64| (q * 1e9).round() / 1e9;
        targets
            .map(|q_deg| q_deg.into_iter().map(rounded).collect())
            .collect()
    }

    fn corrected(program: &Program, q_deg: &[&[f64]]) -> Vec<u8> {
        program.with(&CompensateAnswer {
            q_deg: q_deg.iter().map(|q_deg| q_deg.to_vec()).collect(),
            ..CompensateAnswer::default()
        })
    }

    #[test]
    fn a_table_keeps_its_form() {
        let text = "\u{feff}# made offline\r\nName;J1 [°];J2 [°];X;Y;Z\r\nP1;\"10,5\"; -20,25;1,5;2;3\r\n\r\nP2;1;2;1;2;3";
        let wanted = "\u{feff}# made offline\r\nName;J1 [°];J2 [°];X;Y;Z\r\nP1;\"10,7500000\"; -20,0000000;1,5;2;3\r\n\r\nP2;1,5000000;2,5000000;1;2;3";
        let utf16 =
            |text: &str| -> Vec<u8> { text.encode_utf16().flat_map(u16::to_le_bytes).collect() };
        for (bytes, wanted) in [
            (text.as_bytes().to_vec(), wanted.as_bytes().to_vec()),
            (utf16(text), utf16(wanted)),
        ] {
            let program = parse(&bytes, "{}").unwrap();
            assert_eq!(q_deg(&program), [[10.5, -20.25], [1.0, 2.0]]);
            assert_eq!(program.joints, ["J1 [°]", "J2 [°]"]);
            assert_eq!(program.other_poses, ["X", "Y", "Z"]);
            let found = corrected(&program, &[&[10.75, -20.0], &[1.5, 2.5]]);
            assert_eq!(found, wanted, "{}", String::from_utf8_lossy(&found));
            assert_eq!(program.lines(), [3, 5]);
        }
    }

    #[test]
    fn units_are_stated_as_for_measurements() {
        let text = "J1,J2\n1,2\n";
        let error = parse(text.as_bytes(), "{}").unwrap_err();
        assert_eq!(error.issues[0].code, "missing_unit");
        let program = parse(text.as_bytes(), "{\"joint_unit\": \"rad\"}").unwrap();
        let found = corrected(&program, &[&[90.0, 180.0]]);
        assert_eq!(found, b"J1,J2\n1.570796327,3.141592654\n");
        assert!(parse(b"J1 [deg];J2 [deg]\n1,5;2.5\n", "{}").is_err());
    }

    #[test]
    fn a_comma_in_a_number_is_no_separator() {
        let text = "Name,J1 [deg],J2 [deg]\nP1,\"10,5\",20\n";
        let program = parse(text.as_bytes(), "{}").unwrap();
        let found = corrected(&program, &[&[10.75, 20.5]]);
        let wanted = "Name,J1 [deg],J2 [deg]\nP1,\"10,7500000\",\"20,5000000\"\n";
        assert_eq!(String::from_utf8(found).unwrap(), wanted);
    }

    #[test]
    fn robot_programs_are_refused_with_the_way_round() {
        let kuka = "DEFDAT CAL\nDECL E6AXIS XP2={A1 10,A2 -90,A3 0,A4 0,A5 0,A6 0}\nENDDAT\n";
        for text in [
            kuka,
            "DECL E6POS XP1={X 1.0,Y 2.0,Z 3}\n",
            "/JOB\n///PULSE\n",
        ] {
            let error = parse(text.as_bytes(), "{}").unwrap_err();
            assert!(error.issues[0].detail.contains("q1_deg"), "{error}");
        }
    }
}
