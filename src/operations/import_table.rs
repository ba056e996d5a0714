//! Tables of link parameters. A CSV is read like a measurement file: any encoding, separator and decimal mark, comments, and units in the
//! names of columns or below them.

use crate::kinematics::Link;
use crate::kinematics::model::MAX_LINKS;
use crate::measurement::Decimal;
use crate::measurement::columns::mapping::{ColumnRef, Mapping};
use crate::measurement::columns::names::{LENGTHS, Unit, name_and_unit};
use crate::measurement::csv::ParseError;
use crate::measurement::csv::number_text::value;
use crate::measurement::table::decimal_mark::decimal_of;
use crate::measurement::table::text::Source;
use crate::measurement::table::{Next, Table as Cells};
use crate::operations::import_json::{csv_of_json, is_json};
use crate::operations::import_units::{metres_under_millimetres, radians_under_degrees};
use crate::wire::issue::{Invalid, Issue};

/// Maximum size of a table, bytes. A dozen rows with nine columns have two KiB.
const MAX_TABLE_BYTES: usize = 64 * 1024;
/// Code of the refusal of a table.
const INVALID: &str = "invalid_table";
/// Names of the quantities of a link, and the unit that a message proposes. The last three are optional.
const QUANTITIES: [(&str, &[&str], &str); 7] = [
    ("a", &["a"], "mm"),
    ("alpha", &["alpha", "α"], "deg"),
    ("d", &["d"], "mm"),
    (
        "theta_offset",
        &["theta_offset", "theta offset", "theta", "θ", "ϑ"],
        "deg",
    ),
    ("beta", &["beta", "β"], "deg"),
    ("min", &["min"], "deg"),
    ("max", &["max"], "deg"),
];
/// Number of quantities that a table must have.
const N_NEEDED: usize = 4;
/// Names of columns that number the links.
const NUMBERS: [&str; 7] = ["link", "joint", "i", "no", "no.", "nr", "#"];

/// A table of link parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// The numbers of the table, in the convention of the table.
    pub links: Vec<Link>,
    /// Lower and upper limit of each joint, rad, if given.
    pub limits_rad: Vec<Option<(f64, f64)>>,
}

/// A quantity of a link in a column.
struct Column {
    place: usize,
    name: String,
    quantity: usize,
    unit: &'static str,
}

impl Column {
    /// A number of the column in mm or rad.
    fn converted(&self, number: f64) -> f64 {
        match self.unit {
            "deg" => number.to_radians(),
            "rad" => number,
            unit => {
                let factor = LENGTHS.iter().find(|(name, _)| *name == unit);
                number * factor.map_or(1.0, |(_, factor)| *factor)
            }
        }
    }
}

/// Parses a table in CSV or JSON.
pub fn table_of_any(bytes: &[u8]) -> Result<Table, Invalid> {
    if bytes.len() <= MAX_TABLE_BYTES && is_json(bytes) {
        table(&csv_of_json(bytes)?)
    } else {
        table(bytes)
    }
}

/// Parses a table with one row per link, from base to flange. Required columns: a, alpha, d, and theta_offset or theta, each with its unit. Optional
/// columns: beta, min, max, link. The numbers of a link column increase by 1.
pub fn table(bytes: &[u8]) -> Result<Table, Invalid> {
    if bytes.len() > MAX_TABLE_BYTES {
        let detail = format!(
            "the table has {} bytes; at most {MAX_TABLE_BYTES} are read",
            bytes.len()
        );
        return Err(Invalid::at("", "too_large", detail));
    }
    let source = Source::decode(bytes).map_err(|error| unreadable(&error))?;
    let cells = Cells::find(source, &header_names()).map_err(|error| unreadable(&error))?;
    let columns = columns(&cells)?;
    let places: Vec<usize> = columns.iter().map(|column| column.place).collect();
    let decimal = decimal_of(&cells, &places).ok_or_else(|| {
        let detail = "all numbers may have a decimal mark or separators of thousands: write one of them with another number of decimals, such as 1,2340";
        refused(vec![Issue {
            code: "two_readings".into(),
            detail: detail.into(),
            ..Issue::default()
        }])
    })?;
    let mut table = Table {
        links: vec![],
        limits_rad: vec![],
    };
    let mut issues = Vec::new();
    let mut numbers = Numbers::new(&cells);
    cells.each_row(|next| {
        match next {
            Next::Row(row) => {
                issues.extend(numbers.out_of_order(row.line, &row.cells));
                let (link, limits_rad) = link(
                    (table.links.len(), row.line),
                    &row.cells,
                    &columns,
                    decimal,
                    &mut issues,
                );
                table.links.push(link);
                table.limits_rad.push(limits_rad);
            }
            Next::Bad(line, code, detail) => issues.push(Issue {
                line: Some(line),
                code: code.into(),
                detail,
                ..Issue::default()
            }),
            Next::Skipped => {}
        }
        table.links.len() <= MAX_LINKS
    });
    if table.links.is_empty() || table.links.len() > MAX_LINKS {
        issues.push(Issue {
            code: "wrong_length".into(),
            detail: format!("1 to {MAX_LINKS} rows are allowed, one per link"),
            ..Issue::default()
        });
    }
    if issues.is_empty() {
        issues = other_units(&columns, &table.links);
    }
    match issues.is_empty() {
        true => Ok(table),
        false => Err(refused(issues)),
    }
}

/// The issues of columns whose numbers are impossible in their unit.
fn other_units(columns: &[Column], links: &[Link]) -> Vec<Issue> {
    let with = |quantity: &str, unit: &str| {
        let is_it =
            |column: &&Column| QUANTITIES[column.quantity].0 == quantity && column.unit == unit;
        columns.iter().find(is_it)
    };
    type Angle = fn(&Link) -> f64;
    let angles: [(&str, Angle); 2] = [
        ("alpha", |link| link.alpha_rad),
        ("theta_offset", |link| link.theta_offset_rad),
    ];
    let angles = angles.into_iter().filter_map(|(quantity, of)| {
        let degrees: Vec<f64> = links.iter().map(|link| of(link).to_degrees()).collect();
        let name = &with(quantity, "deg")?.name;
        radians_under_degrees(name, &format!("{quantity}_rad"), &degrees)
    });
    let lengths = with("a", "mm").zip(with("d", "mm"));
    let lengths = lengths.and_then(|(a, _)| metres_under_millimetres(&a.name, links));
    angles.chain(lengths).collect()
}

/// The column that numbers the links, and the number of the row before.
struct Numbers {
    column: Option<(usize, String)>,
    before: Option<usize>,
}

impl Numbers {
    fn new(cells: &Cells) -> Self {
        let mut names = cells.header.iter().enumerate();
        let column = names.find(|(_, name)| NUMBERS.contains(&name.trim().to_lowercase().as_str()));
        Self {
            column: column.map(|(place, name)| (place, name.clone())),
            before: None,
        }
    }

    /// The issue of a row whose number is not one more than that of the row before. Cells that are not whole numbers are names, and all
    /// names are allowed.
    fn out_of_order(&mut self, line: usize, cells: &csv::StringRecord) -> Option<Issue> {
        let (place, name) = self.column.as_ref()?;
        let number: usize = cells.get(*place)?.trim().parse().ok()?;
        if number > MAX_LINKS {
            return None; // a column for something else, such as a gear ratio (i)
        }
        let before = self.before.replace(number)?;
        (number != before + 1).then(|| Issue {
            line: Some(line),
            column: Some(name.clone()),
            code: "links_out_of_order".into(),
            detail: format!(
                "link {number} follows link {before}: the rows have to go from the base to the flange, without a gap. Sort them, or remove the column"
            ),
            ..Issue::default()
        })
    }
}

/// Reads the row of a link, and its limits.
fn link(
    (index, line): (usize, usize),
    cells: &csv::StringRecord,
    columns: &[Column],
    decimal: Decimal,
    issues: &mut Vec<Issue>,
) -> (Link, Option<(f64, f64)>) {
    let mut values = [None; QUANTITIES.len()];
    for column in columns {
        let text = cells.get(column.place).unwrap_or_default().trim();
        match value(text, decimal) {
            Some(number) => values[column.quantity] = Some(column.converted(number)),
            None if text.is_empty() && column.quantity >= N_NEEDED => {}
            None => issues.push(Issue {
                row: Some(index),
                line: Some(line),
                column: Some(column.name.clone()),
                code: "not_a_number".into(),
                detail: not_a_number(text),
                ..Issue::default()
            }),
        }
    }
    let [a_mm, alpha, d_mm, theta, beta, low, high] = values;
    let link = Link {
        a_mm: a_mm.unwrap_or(0.0),
        alpha_rad: alpha.unwrap_or(0.0),
        d_mm: d_mm.unwrap_or(0.0),
        theta_offset_rad: theta.unwrap_or(0.0),
        beta_rad: beta.unwrap_or(0.0),
    };
    (link, low.zip(high))
}

fn not_a_number(text: &str) -> String {
    let is_symbol = text.contains(|c: char| c.is_alphabetic() || c == 'θ');
    let remedy = match is_symbol {
        true => {
            ": write numbers alone. The joint value is added to theta, so write 0 for q1 and 90 for θ1+90°; and 90 for pi/2 in degrees"
        }
        false => "",
    };
    format!("{text:?} is not a number{remedy}")
}

/// The names by which the header of a table is recognised.
fn header_names() -> Mapping {
    let units = [
        "", "_mm", "_m", "_deg", "_rad", " [mm]", " [m]", " [deg]", " [rad]", " [°]", " (mm)",
        " (m)", " (deg)", " (rad)", " (°)",
    ];
    let names = QUANTITIES.iter().flat_map(|(_, names, _)| *names);
    let headers =
        names.flat_map(|name| units.map(|unit| ColumnRef::Header(format!("{name}{unit}"))));
    Mapping {
        ignore: headers.collect(),
        ..Mapping::default()
    }
}

/// The columns with quantities of links.
fn columns(cells: &Cells) -> Result<Vec<Column>, Invalid> {
    let mut columns: Vec<Column> = Vec::new();
    let mut issues = Vec::new();
    for (place, name) in cells.header.iter().enumerate() {
        let below = cells
            .units
            .as_ref()
            .and_then(|units| units.get(place).copied().flatten());
        match column(place, name, below) {
            Ok(Some(column))
                if columns
                    .iter()
                    .any(|known| known.quantity == column.quantity) =>
            {
                issues.push(about(
                    name,
                    "repeated_column",
                    "this quantity stands in two columns",
                ));
            }
            Ok(Some(column)) => columns.push(column),
            Ok(None) => {}
            Err(invalid) => issues.extend(invalid.issues),
        }
    }
    let is_missing = |quantity: &usize| columns.iter().all(|column| column.quantity != *quantity);
    if issues.is_empty() {
        issues = (0..N_NEEDED)
            .filter(is_missing)
            .map(|quantity| {
                let (name, _, unit) = QUANTITIES[quantity];
                about(
                    &format!("{name}_{unit}"),
                    "missing_column",
                    "this column is needed",
                )
            })
            .collect();
    }
    match issues.is_empty() {
        true => Ok(columns),
        false => Err(refused(issues)),
    }
}

/// The column with this name; `None` for a column that is not read.
fn column(place: usize, name: &str, below: Option<Unit>) -> Result<Option<Column>, Invalid> {
    let (base, unit) = name_and_unit(name);
    let base = base.trim();
    if base.is_empty() || NUMBERS.contains(&base) {
        return Ok(None);
    }
    let known = QUANTITIES
        .iter()
        .position(|(_, names, _)| names.contains(&base));
    let Some(quantity) = known else {
        let detail = format!(
            "the column {name:?} is not known; a table has a_mm, alpha_deg, d_mm, theta_offset_deg (or _m, _rad), and may have beta_deg, min_deg, max_deg, link"
        );
        return Err(refused(vec![about(name, "unknown_column", &detail)]));
    };
    let (own, _, proposed) = QUANTITIES[quantity];
    let other = if proposed == "mm" { "m" } else { "rad" };
    let unit = match unit.or(below) {
        Some(Unit::Is(unit)) => Some(unit),
        _ => None,
    };
    let is_length = |unit: &str| LENGTHS.iter().any(|(name, _)| *name == unit);
    let fits = |unit: &&str| match proposed {
        "mm" => is_length(unit),
        _ => matches!(*unit, "deg" | "rad"),
    };
    let Some(unit) = unit.filter(fits) else {
        let detail = format!(
            "column {name} has no unit of its quantity: name it {own}_{proposed} or {own}_{other}"
        );
        return Err(refused(vec![about(name, "missing_unit", &detail)]));
    };
    Ok(Some(Column {
        place,
        name: name.to_owned(),
        quantity,
        unit,
    }))
}

fn refused(issues: Vec<Issue>) -> Invalid {
    Invalid {
        code: INVALID,
        issues,
    }
}

fn about(column: &str, code: &str, detail: &str) -> Issue {
    Issue {
        column: Some(column.into()),
        code: code.into(),
        detail: detail.into(),
        ..Issue::default()
    }
}

fn unreadable(error: &ParseError) -> Invalid {
    let detail = error
        .issues
        .first()
        .map_or("", |issue| issue.detail.as_str());
    Invalid::at(
        "",
        "unreadable_table",
        format!("the table cannot be read: {detail}"),
    )
}

#[cfg(test)]
mod tests {
    use super::table;
    use crate::kinematics::Link;

    const RIGHT: f64 = std::f64::consts::FRAC_PI_2;

    fn links(text: &[u8]) -> Vec<Link> {
        table(text)
            .unwrap_or_else(|e| panic!("{}: {e:?}", String::from_utf8_lossy(text)))
            .links
    }

    #[test]
    fn tables_of_any_form_are_read_alike() {
        let utf16: Vec<u8> = "\u{feff}a [m]\tα [°]\td [m]\tθ [°]\n0,25\t-90\t0,5\t90\n"
            .encode_utf16()
            .flat_map(u16::to_le_bytes)
            .collect();
        for text in [
            "a_mm,alpha_deg,d_mm,theta_offset_deg\n250,-90,500,90\n".as_bytes(),
            b"link;a_mm;alpha_deg;d_mm;theta_deg\n1;250,0;-90;500,0;90,0\n",
            b"# the arm\ntheta_deg\td_mm\ta_mm\talpha_deg\n\n90\t500\t250\t-90\n",
            b"i,a,alpha,d,theta\n,mm,deg,mm,deg\n1,250,-90,500,90\n",
            b"a (mm) | alpha (deg) | d (mm) | theta (deg)\n250 | -90 | 500 | 90\n",
            &utf16,
        ] {
            let found = links(text);
            assert_eq!(found.len(), 1);
            assert_eq!((found[0].a_mm, found[0].d_mm), (250.0, 500.0));
            assert!((found[0].alpha_rad + RIGHT).abs() < 1e-15);
            assert!((found[0].theta_offset_rad - RIGHT).abs() < 1e-15);
        }
    }

    #[test]
    fn what_a_table_does_not_say_is_asked_for() {
        for (text, code, named) in [
            (
                "a,alpha,d,theta\n250,-90,500,90\n",
                "missing_unit",
                "a_mm or a_m",
            ),
            ("a_mm,alpha_deg,d_mm\n1,2,3\n", "missing_column", "needed"),
            (
                "a_mm,a_m,alpha_deg,d_mm,theta_deg\n1,1,2,3,4\n",
                "repeated_column",
                "two columns",
            ),
            (
                "a_mm,alpha_deg,d_mm,theta_deg,sigma\n1,2,3,4,5\n",
                "unknown_column",
                "sigma",
            ),
            (
                "a_mm,alpha_deg,d_mm,theta_deg\n1,2,x,4\n",
                "not_a_number",
                "\"x\"",
            ),
            (
                "link,a_mm,alpha_deg,d_mm,theta_deg\n2,1,2,3,4\n1,1,2,3,4\n",
                "links_out_of_order",
                "link 1 follows link 2",
            ),
            (
                "a_mm;alpha_deg;d_mm;theta_deg\n1,250;2,500;3,500;4,500\n",
                "two_readings",
                "thousands",
            ),
        ] {
            let error = table(text.as_bytes()).unwrap_err();
            let issue = &error.issues[0];
            assert_eq!(issue.code, code, "{issue:?}");
            assert!(issue.detail.contains(named), "{issue:?}");
        }
    }
}
