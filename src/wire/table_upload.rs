//! Parses an uploaded table, or two files that belong together, to a measurement set. Also parses stored uploads again.

use crate::measurement::columns::mapping::Mapping;
use crate::measurement::csv::ParseError;
use crate::measurement::join::join;
use crate::measurement::table::columns::Needs;
use crate::measurement::table::points::{self, Content, Preview, TableOptions};
use crate::measurement::table::text::Source;
use crate::measurement::{Decimal, Frame, MeasurementSet, RotationConvention};
use crate::wire::columns::{ColumnsBody, FilePart};
use crate::wire::instrument;
use crate::wire::issue::{Invalid, Issue, MAX_ISSUES};
use crate::wire::multipart::{self, is_multipart};
use crate::wire::understood::{JoinBody, JoinedFiles, Reading, UnderstoodBody};
use crate::wire::workbook;

/// Code for a file that cannot be read.
const INVALID: &str = "invalid_measurements";

/// The files of an upload.
#[derive(Clone, Debug)]
pub struct Files<'a> {
    /// The only file, or the robot's file and the instrument's file.
    pub files: Vec<(FilePart, &'a [u8])>,
    /// The column mapping that was sent with the files.
    pub columns: Option<ColumnsBody>,
}

impl<'a> Files<'a> {
    /// The files of a body: a single file, or the parts of a form.
    ///
    /// # Errors
    /// [`Invalid`] for a form without the required files, or with other parts.
    pub fn new(content_type: &str, body: &'a [u8]) -> Result<Self, Invalid> {
        if !is_multipart(content_type) {
            return Ok(Self {
                files: vec![(FilePart::Table, body)],
                columns: None,
            });
        }
        let (mut files, mut columns) = (Vec::new(), None);
        for part in multipart::parts(content_type, body)? {
            let file = [FilePart::Table, FilePart::Robot, FilePart::Instrument]
                .into_iter()
                .find(|file| file.as_str() == part.name);
            let is_twice = files.iter().any(|(known, _)| Some(*known) == file);
            match (file, part.name.as_str()) {
                (Some(file), _) if !is_twice => files.push((file, part.body)),
                (None, "columns") if columns.is_none() => {
                    columns = Some(ColumnsBody::parse(part.body)?);
                }
                (_, name) => {
                    let detail = format!(
                        "part {name:?}: a form has robot and instrument, or table, and perhaps columns, each once"
                    );
                    return Err(Invalid::at("", "malformed_multipart", detail));
                }
            }
        }
        files.sort_by_key(|(part, _)| *part as usize);
        let parts: Vec<FilePart> = files.iter().map(|(part, _)| *part).collect();
        match parts[..] {
            [FilePart::Table] | [FilePart::Robot, FilePart::Instrument] => {
                Ok(Self { files, columns })
            }
            _ => Err(Invalid::at(
                "",
                "malformed_multipart",
                "a form has the parts robot and instrument (two files), or table (one), and perhaps columns",
            )),
        }
    }
}

/// Options for reading an upload.
#[derive(Clone, Copy, Debug)]
pub struct UploadOptions<'a> {
    /// The column mapping of the caller.
    pub columns: &'a ColumnsBody,
    /// The decimal mark, if it is stated separately from the mapping.
    pub decimal: Option<Decimal>,
    /// The rotation convention of poses.
    pub rotation: Option<RotationConvention>,
    /// The frame of the positions.
    pub frame: Frame,
    /// The robot's number of links.
    pub n_joints: usize,
    /// Check of the text in `measured_at`.
    pub is_time: fn(&str) -> bool,
}

impl UploadOptions<'_> {
    fn for_file<'m>(&self, mapping: &'m Mapping, part: FilePart) -> TableOptions<'m> {
        TableOptions {
            mapping,
            n_joints: self.n_joints,
            needs: needs(part),
            rotation: self.rotation,
            is_time: self.is_time,
            are_targets: false,
        }
    }
}

/// Reads the files of an upload.
pub fn read(files: &Files, options: &UploadOptions) -> Result<(MeasurementSet, Reading), Invalid> {
    let mut mappings = Vec::new();
    for (part, _) in &files.files {
        let mut mapping = options.columns.mapping(*part)?;
        state_decimal(&mut mapping, options.decimal)?;
        mappings.push(mapping);
    }
    let read = |at: usize| read_file(files.files[at], &mappings[at], options);
    if files.files.len() == 1 {
        let content = read(0)?;
        let set = MeasurementSet::new(options.frame, content.points);
        let reading = Reading {
            understood: Some(UnderstoodBody::from(&content.understood).with_targets_of(&set)),
            ..Reading::default()
        };
        return Ok((set, reading));
    }
    let (robot, instrument) = match (read(0), read(1)) {
        (Ok(robot), Ok(instrument)) => (robot, instrument),
        // The issues of both files are reported together.
        (Err(mut of_robot), Err(of_instrument)) => {
            of_robot.issues.extend(of_instrument.issues);
            of_robot.issues.truncate(MAX_ISSUES);
            return Err(of_robot);
        }
        (Err(error), _) | (_, Err(error)) => return Err(error),
    };
    joined(&robot, &instrument, &options.columns.join()?, options.frame)
}

fn joined(
    robot: &Content,
    instrument: &Content,
    how: &crate::measurement::join::JoinOptions,
    frame: Frame,
) -> Result<(MeasurementSet, Reading), Invalid> {
    let (points, found) = join(robot, instrument, how)
        .map_err(|error| invalid(vec![Issue::at("/join", error.code, error.detail)]))?;
    let set = MeasurementSet::new(frame, points);
    // Targets are numbered by their order in the paired rows.
    let of_instrument = UnderstoodBody::from(&instrument.understood).with_targets_of(&set);
    let reading = Reading {
        joined: Some(JoinedFiles {
            robot: UnderstoodBody::from(&robot.understood),
            instrument: of_instrument,
            join: JoinBody::from(&found),
        }),
        ..Reading::default()
    };
    Ok((set, reading))
}

/// Parses a stored upload again, with the interpretation that was stored with it.
///
/// # Errors
/// [`Invalid`]. This does not happen for an upload that was accepted once.
pub fn read_stored(
    reading: &Reading,
    files: &Files,
    rotation: Option<RotationConvention>,
    frame: Frame,
    n_joints: usize,
) -> Result<MeasurementSet, Invalid> {
    let columns = ColumnsBody::default();
    let options = UploadOptions {
        columns: &columns,
        decimal: None,
        rotation,
        frame,
        n_joints,
        is_time: |_| true,
    };
    let read = |at: usize, understood: &UnderstoodBody| {
        let file = files.files.get(at).copied();
        let file =
            file.ok_or_else(|| Invalid::at("", "unreadable", "the upload has no such file"))?;
        read_file(file, &understood.mapping(), &options)
    };
    let mut set = match (&reading.understood, &reading.joined) {
        (_, Some(two)) => {
            let (robot, instrument) = (read(0, &two.robot)?, read(1, &two.instrument)?);
            joined(&robot, &instrument, &two.join.options(), frame)?.0
        }
        (Some(understood), None) => MeasurementSet::new(frame, read(0, understood)?.points),
        (None, None) => {
            return Err(Invalid::at(
                "",
                "unreadable",
                "nothing says how it was read",
            ));
        }
    };
    if let Some(stated) = instrument::resolve(None, reading.instrument)? {
        stated.apply_to(&mut set)?;
    }
    Ok(set)
}

fn state_decimal(mapping: &mut Mapping, stated: Option<Decimal>) -> Result<(), Invalid> {
    match (mapping.decimal, stated) {
        (Some(one), Some(other)) if one != other => Err(Invalid::at(
            "/decimal",
            "invalid_columns",
            "the mapping states another decimal mark than the request: leave one of them out",
        )),
        (own, stated) => {
            mapping.decimal = own.or(stated);
            Ok(())
        }
    }
}

/// The columns that a file of an upload must have.
pub fn needs(part: FilePart) -> Needs {
    match part {
        FilePart::Table => Needs::Points,
        FilePart::Robot => Needs::Joints,
        FilePart::Instrument => Needs::Positions,
    }
}

/// A file as text. For a workbook, the name of the used sheet is written to the mapping.
fn source<'a>(bytes: &'a [u8], mapping: &mut Mapping) -> Result<Source<'a>, Invalid> {
    if let Some(kind) = workbook::workbook(bytes) {
        let (source, sheet) = workbook::read(kind, bytes, mapping)?;
        mapping.sheet = Some(sheet);
        return Ok(source);
    }
    Source::from_bytes(bytes).map_err(|error| table_error(&error))
}

fn read_file(
    (part, bytes): (FilePart, &[u8]),
    mapping: &Mapping,
    options: &UploadOptions,
) -> Result<Content, Invalid> {
    let mut mapping = mapping.clone();
    let read = source(bytes, &mut mapping).and_then(|source| {
        points::read(source, &options.for_file(&mapping, part)).map_err(|error| table_error(&error))
    });
    read.map_err(|error| with_part_name(error, part))
}

/// Makes a preview of one file of an upload.
///
/// # Errors
/// [`Invalid`] if not even the columns of the file can be separated.
pub fn preview(
    part: FilePart,
    bytes: &[u8],
    options: &UploadOptions,
    n_rows: usize,
) -> Result<Preview, Invalid> {
    let mut mapping = options.columns.mapping(part)?;
    state_decimal(&mut mapping, options.decimal)?;
    let source = source(bytes, &mut mapping).map_err(|error| with_part_name(error, part))?;
    points::preview(source, &options.for_file(&mapping, part), n_rows)
        .map_err(|error| with_part_name(table_error(&error), part))
}

fn invalid(issues: Vec<Issue>) -> Invalid {
    Invalid {
        code: INVALID,
        issues,
    }
}

/// Adds to each issue which of the two files it is about.
fn with_part_name(mut error: Invalid, part: FilePart) -> Invalid {
    if part != FilePart::Table {
        for issue in &mut error.issues {
            issue.pointer = Some(format!("/{}", part.as_str()));
            issue.detail = format!("{} file: {}", part.as_str(), issue.detail);
        }
    }
    error
}

/// The refusal of a table.
pub fn table_error(error: &ParseError) -> Invalid {
    let issue = |issue: &crate::measurement::csv::Issue| Issue {
        row: issue.row,
        line: issue.line,
        column: issue.column.clone(),
        code: issue.code.into(),
        detail: issue.detail.clone(),
        ..Issue::default()
    };
    invalid(error.issues.iter().take(MAX_ISSUES).map(issue).collect())
}
