//! Tables that were read with other values than they have, or refused without need.

use super::*;

/// A table with columns of others, a name in front and a remark behind.
pub(super) fn with_remarks(back: fn(usize) -> Vec<String>) -> Written {
    let mut names = vec!["Name".to_owned()];
    names.extend(header(
        |j| format!("J{j} [deg]"),
        ["X [mm]", "Y [mm]", "Z [mm]"],
    ));
    names.push("Remark".into());
    Written {
        header: names,
        front: |row| vec![format!("P{}", row + 1)],
        back,
        ..Written::default()
    }
}

fn code(text: &str, columns: &str) -> Option<(String, String)> {
    let error = read(text.as_bytes(), columns).err()?;
    Some((
        error.issues[0].code.to_string(),
        error.issues[0].detail.clone(),
    ))
}

pub(super) fn refused_as(name: &str, text: &str, wanted: &str, hint: &str) {
    let Some((code, detail)) = code(text, "") else {
        panic!("{name}: taken\n{text}")
    };
    assert!(
        code == wanted && detail.contains(hint),
        "{name}: {code} {detail}"
    );
}

pub(super) fn is_read(name: &str, text: &str) {
    let (set, reading) = read(text.as_bytes(), "").unwrap_or_else(|e| panic!("{name}: {e:?}"));
    is_true(name, &set);
    is_read_again(name, text.as_bytes(), &set, &reading.unwrap());
}

/// FANUC and ABB call the posture of the arm a configuration.
#[test]
fn the_posture_of_the_arm_is_no_label_of_a_pose() {
    let postures = |name: &str| {
        let mut names = vec![name.to_owned()];
        names.extend(header(|j| format!("q{j}_deg"), ["x_mm", "y_mm", "z_mm"]));
        Written {
            header: names,
            front: |row| vec![if row % 2 == 0 { "N U T" } else { "F U T" }.to_owned()],
            ..Written::default()
        }
    };
    for name in ["configuration", "Configuration"] {
        let text = postures(name).text();
        let hint = format!("{{\"ignore\": [{name:?}]}}");
        refused_as(name, &text, "configuration_suspect", &hint);
    }
}

#[test]
fn a_quote_that_closes_nothing_swallows_no_row() {
    let one = with_remarks(|row| vec![if row == 3 { "\"hot" } else { "" }.to_owned()]);
    is_read("one remark with a quote", &one.text());
    let all = with_remarks(|_| vec!["\"hot".to_owned()]);
    is_read("remarks with a quote", &all.text());
    // A quote ends the cell, with rows in between: nothing tells which it is.
    let inches = with_remarks(|row| vec![if row == 3 { "\"hot" } else { "5\"" }.to_owned()]);
    refused_as(
        "inches",
        &inches.text(),
        "two_readings",
        "Remove these quotes",
    );
    let ditto = with_remarks(|_| vec!["\"".to_owned()]);
    refused_as(
        "as above",
        &ditto.text(),
        "two_readings",
        "line 2 has a quote",
    );
    let mut in_front = with_remarks(|_| vec!["ok".into()]);
    in_front.front = |row| vec![format!("\"P{row}")];
    is_read("names with a quote", &in_front.text());
    let broken = with_remarks(|_| vec!["\"two\nlines, quoted\"".into()]);
    let (set, _) = read(broken.text().as_bytes(), "").unwrap();
    is_true("remarks of two lines", &set);
    let text = broken.text() + "P10,1,2,3,4,5,6,x,8,9,bad\n";
    let error = read(text.as_bytes(), "").unwrap_err();
    assert_eq!(error.issues[0].line, Some(2 * N_ROWS + 2), "{error:?}");
}

#[test]
fn header_cells_of_two_lines_are_read() {
    let text = Written::default().text();
    let names = header(
        |j| format!("\"Axis {j}\n[deg]\""),
        ["\"X\n(mm)\"", "\"Y\n(mm)\"", "\"Z\n(mm)\""],
    );
    let (_, rows) = text.split_once('\n').unwrap();
    is_read(
        "a header of two lines",
        &format!("{}\n{rows}", names.join(",")),
    );
}

#[test]
fn a_column_with_another_value_in_each_row_names_no_reflectors() {
    // In a table of others, a column Target has no meaning of its own.
    let mut table = Written {
        header: std::iter::once("Target".to_owned())
            .chain(header(
                |j| format!("J{j} [deg]"),
                ["X [mm]", "Y [mm]", "Z [mm]"],
            ))
            .collect(),
        front: |row| vec![(row + 1).to_string()],
        ..Written::default()
    };
    let (set, reading) = read(table.text().as_bytes(), "").unwrap();
    assert!(set.points.iter().all(|point| point.target == 0));
    assert_eq!(reading.unwrap().understood.unwrap().ignored, ["Target"]);
    // In kincal's own form it has.
    table.header[1..].clone_from_slice(&own_header());
    refused_as(
        "numbers of points",
        &table.text(),
        "two_readings",
        "names points",
    );
    let (set, _) = read(table.text().as_bytes(), "\"ignore\": [\"Target\"]").unwrap();
    assert!(set.points.iter().all(|point| point.target == 0));
}

#[test]
fn reflectors_have_names_or_numbers() {
    let mut table = Written {
        header: std::iter::once("SMR".to_owned())
            .chain(own_header())
            .collect(),
        front: |row| vec![["B", "A", "C"][row % 3].to_owned()],
        ..Written::default()
    };
    let mapping = "\"target\": \"SMR\"";
    let (set, reading) = read(table.text().as_bytes(), mapping).unwrap();
    let targets: Vec<usize> = set.points.iter().map(|point| point.target).collect();
    assert_eq!(targets, [0, 1, 2, 0, 1, 2, 0, 1, 2]);
    let reading = reading.unwrap();
    assert_eq!(
        reading.understood.as_ref().unwrap().reflectors,
        ["B", "A", "C"]
    );
    is_read_again("names", table.text().as_bytes(), &set, &reading);
    table.front = |row| vec![(row % 3).to_string()];
    let (set, reading) = read(table.text().as_bytes(), mapping).unwrap();
    assert_eq!(set.points[5].target, 2);
    assert!(reading.unwrap().understood.unwrap().reflectors.is_empty());
}

/// The table with a row behind its own, with the values of each column as `statistic` has them.
fn with_statistic(written: &Written, front: &str, statistic: fn(&[f64]) -> f64) -> String {
    let column = |at: usize| -> Vec<f64> {
        let rows = truth().into_iter();
        rows.map(|(q, p)| if at < 6 { q[at] } else { p[at - 6] })
            .collect()
    };
    let cells = (0..9).map(|at| format!("{:.3}", statistic(&column(at))));
    let cells: Vec<String> = std::iter::once(front.to_owned()).chain(cells).collect();
    format!("{}{}\n", written.text(), cells.join(","))
}

pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

pub(super) fn deviation(values: &[f64]) -> f64 {
    let mean = mean(values);
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (squares / (values.len() - 1) as f64).sqrt()
}

fn least(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

pub(super) fn named_rows() -> Written {
    Written {
        header: std::iter::once("Name".to_owned())
            .chain(header(
                |j| format!("J{j} [deg]"),
                ["X [mm]", "Y [mm]", "Z [mm]"],
            ))
            .collect(),
        front: |row| vec![format!("P{}", row + 1)],
        ..Written::default()
    }
}

#[test]
fn rows_of_statistics_are_no_measurements() {
    let table = named_rows();
    for label in ["", "keskiarvo", "P10"] {
        let text = with_statistic(&table, label, mean);
        refused_as(label, &text, "summary_row", "row 9 is the mean");
    }
    let text = with_statistic(&table, "s", deviation);
    refused_as("s", &text, "summary_row", "standard deviation");
    // With the least values below the mean, as reports list them.
    let last = |statistic| {
        with_statistic(&table, "", statistic)
            .lines()
            .next_back()
            .unwrap()
            .to_owned()
    };
    let text = format!("{}{}\n{}\n", table.text(), last(mean), last(least));
    refused_as("two rows", &text, "summary_row", "row 9 is the mean");
    // On top.
    let text = table.text();
    let (names, rows) = text.split_once('\n').unwrap();
    let text = format!("{names}\n{}\n{rows}", last(mean));
    refused_as("on top", &text, "summary_row", "row 0 is the mean");
}

#[test]
fn poses_that_resemble_statistics_are_measurements() {
    // A first pose at the least value of every column.
    let text = with_statistic(&named_rows(), "P10", least);
    assert_eq!(
        read(text.as_bytes(), "").unwrap().0.points.len(),
        N_ROWS + 1
    );
    // One pose measured again and again: all rows are the mean within the resolution.
    let rows: String = (0..30)
        .map(|row| format!("10,20,30,40,50,60,{}.001,200,300\n", 100 + row % 2 / 2))
        .collect();
    let text = format!("{}\n{rows}", own_header().join(","));
    assert_eq!(read(text.as_bytes(), "").unwrap().0.points.len(), 30);
    // A joint that sweeps to both sides of its centre, where the last pose is.
    let row = |deg: f64| {
        let rad = deg.to_radians();
        format!(
            "{deg:.4},0,0,0,0,0,{:.4},{:.4},{:.4}\n",
            900.0 * rad.cos(),
            900.0 * rad.sin(),
            0.02 * deg
        )
    };
    let rows: String = [-60.0, -40.0, -20.0, 20.0, 40.0, 60.0, 0.0]
        .map(row)
        .concat();
    let text = format!("{}\n{rows}", own_header().join(","));
    assert_eq!(read(text.as_bytes(), "").unwrap().0.points.len(), 7);
    // A column of remarks that is left aside may have any words.
    let mut remarks = named_rows();
    remarks.front = |row| vec![if row == 4 { "max" } else { "far" }.to_owned()];
    refused_as("remarks", &remarks.text(), "summary_row", "\"max\"");
    assert!(read(remarks.text().as_bytes(), "\"ignore\": [\"Name\"]").is_ok());
}

#[test]
fn one_row_that_was_not_measured_is_refused() {
    for mark in ["0", "-9999", "99999.9", "-32768"] {
        let text = named_rows().text() + &format!("P10,1,2,3,4,5,6,{mark},{mark},{mark}\n");
        refused_as(mark, &text, "not_measured", mark);
    }
    // A coordinate among the others may have any value.
    let rows: String = (0..12)
        .map(|row| {
            format!(
                "{0},{1},{2},4,{0},{1},{3}.25,9999,{3}.5\n",
                3 * row,
                7 - row,
                row * row,
                9000 + 300 * row
            )
        })
        .collect();
    let text = format!(
        "{}\n{}1,2,3,4,5,6,7000.25,15000,8000.5\n9,2,3,4,5,6,7000.25,4000,8000.5\n",
        own_header().join(","),
        rows
    );
    assert_eq!(read(text.as_bytes(), "").unwrap().0.points.len(), 14);
}

#[test]
fn gons_are_gons() {
    let gon = |v: f64| format!("{:.6}", v / 0.9);
    let table = Written {
        header: header(|j| format!("J{j} [gon]"), ["X [mm]", "Y [mm]", "Z [mm]"]),
        angle: gon,
        ..Written::default()
    };
    let is_close = |text: &str, columns: &str| {
        let (set, reading) = read(text.as_bytes(), columns).unwrap();
        for (point, (q, _)) in set.points.iter().zip(truth()) {
            for (read, meant) in point.q_rad.iter().zip(q) {
                assert!(
                    (read.to_degrees() - meant).abs() < 1e-6,
                    "{read} for {meant}°"
                );
            }
        }
        is_read_again("gon", text.as_bytes(), &set, &reading.unwrap());
    };
    is_close(&table.text(), "");
    let text = table.text().replace("[gon]", "[grad]");
    refused_as("grad", &text, "two_readings", "q1_gon");
    let columns = by_number(1, "gon", "mm");
    is_close(&text, &columns);
    is_close(
        &table.text().replace(" [gon]", ""),
        "\"joint_unit\": \"gon\"",
    );
    refused_as(
        "two units",
        &table.text().replace("J6 [gon]", "J6 [deg]"),
        "mixed_units",
        "column J6 [deg] in deg",
    );
}

#[test]
fn rows_may_end_before_columns_that_are_left_aside() {
    let stripped = |value: f64| {
        let text = four(value);
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    };
    let remarks = |row: usize| vec![if row == 4 { "warm" } else { "" }.to_owned()];
    let mut table = with_remarks(remarks);
    for is_stripped in [false, true] {
        if is_stripped {
            table.length = stripped;
        }
        let text = table.text();
        let short = text.replace(",\n", "\n");
        assert_ne!(text, short);
        refused_as(
            "short rows",
            &short,
            "wrong_cell_count",
            "leave their columns aside in the column mapping: {\"ignore\": [\"Remark\"]}",
        );
        let (set, reading) = read(short.as_bytes(), "\"ignore\": [\"Remark\"]").unwrap();
        is_true("short rows", &set);
        is_read_again("short rows", short.as_bytes(), &set, &reading.unwrap());
        // Cut off within the last row.
        let cut = short.trim_end().rsplit_once(',').unwrap().0;
        let error = read(cut.as_bytes(), "\"ignore\": [\"Remark\"]").unwrap_err();
        assert!(
            error.issues[0]
                .detail
                .contains("the end of the row is missing")
        );
    }
}

#[test]
fn a_short_row_whose_remark_is_a_number_is_refused() {
    let text = with_remarks(|_| vec!["ok".into()]).text();
    is_read("whole", &text);
    let row = text.lines().nth(3).unwrap();
    let cells: Vec<&str> = row.split(',').collect();
    for remark in ["5", "21.5", "0.02", "-3.25", "99999.1234", "12.3456"] {
        let without_y = [&cells[..8], &cells[9..10], &[remark]].concat().join(",");
        let text = text.replace(row, &without_y);
        refused_as(remark, &text, "wrong_cell_count", "row 2 has 10 cells");
        let error = read(text.as_bytes(), "").unwrap_err();
        assert_eq!(error.issues[0].line, Some(4), "{error:?}");
    }
}

/// A column that is left aside excuses no short row if it has numbers: the missing cell may be another one.
#[test]
fn a_short_row_is_refused_although_a_column_of_numbers_is_left_aside() {
    let text = with_remarks(|_| vec!["1".into()]).text();
    let row = text.lines().nth(3).unwrap();
    let cells: Vec<&str> = row.split(',').collect();
    let without_y = [&cells[..8], &cells[9..]].concat().join(",");
    let text = text.replace(row, &without_y);
    let (code, detail) = code(&text, "\"ignore\": [\"Remark\"]").unwrap();
    assert_eq!(code, "wrong_cell_count");
    assert!(detail.contains("row 2 has 10 cells"), "{detail}");
}

#[test]
fn numbers_that_are_split_at_a_separator_of_thousands_are_refused() {
    let thousands = |v: f64| {
        let text = four(1000.0 + v.abs() % 1000.0);
        format!("{}1,{}", if v < 0.0 { "-" } else { "" }, &text[1..])
    };
    let mut table = Written {
        length: thousands,
        ..Written::default()
    };
    // Without a header, and with names that the rows fill by chance.
    let text = table.text();
    let (_, rows) = text.split_once('\n').unwrap();
    let hint = "row 0, column column 7: -1 stands in front of 499.8787";
    for (rows, name) in [
        (rows.to_owned(), "commas"),
        (rows.replace(',', " "), "spaces"),
    ] {
        let error = read(rows.as_bytes(), &by_number(1, "deg", "mm")).unwrap_err();
        assert!(error.issues[0].detail.contains(hint), "{name}: {error:?}");
        assert_eq!(error.issues[0].line, Some(1));
    }
    table
        .header
        .extend(["RMS", "Temperature", "Remark"].map(str::to_owned));
    refused_as(
        "names by chance",
        &table.text(),
        "wrong_cell_count",
        "write the numbers without such separators, or in quotes",
    );
    // Whole joint values in front of three digits are usual.
    let rows: String = (0..9)
        .map(|row| {
            format!(
                "1,2,3,4,{},{},8{row}1.25,9{row}2.5,70{row}.75\n",
                row * row,
                40 - row
            )
        })
        .collect();
    let text = format!("{}\n{rows}", own_header().join(","));
    assert_eq!(read(text.as_bytes(), "").unwrap().0.points.len(), 9);
}

#[test]
fn a_table_that_stands_twice_in_a_file_is_refused() {
    let text = named_rows().text();
    let (names, rows) = text.split_once('\n').unwrap();
    let doubled: String = rows.lines().map(|row| format!("{row}\n{row}\n")).collect();
    let tail: String = rows.lines().skip(4).map(|row| format!("{row}\n")).collect();
    for (name, text, row, first) in [
        ("below", format!("{text}{rows}"), 9, 0),
        ("three times", format!("{text}{rows}{rows}"), 9, 0),
        ("row by row", format!("{names}\n{doubled}"), 1, 0),
        ("the end alone", format!("{text}{tail}"), 9, 4),
    ] {
        let hint = format!("row {row} agrees with row {first} in every digit");
        refused_as(name, &text, "rows_twice", &hint);
        let error = read(text.as_bytes(), "").unwrap_err();
        assert_eq!(error.issues[0].line, Some(row + 2), "{name}");
        assert!(error.issues[0].detail.contains("remove these rows"));
    }
    // The same poses, measured again.
    let again: String = rows.lines().map(|row| format!("{row}5\n")).collect();
    assert_eq!(
        read(format!("{text}{again}").as_bytes(), "")
            .unwrap()
            .0
            .points
            .len(),
        18
    );
    // Some repetitions that agree are chance, and coarse ones are usual.
    let two: String = rows.lines().take(2).map(|row| format!("{row}\n")).collect();
    assert!(read(format!("{text}{again}{two}").as_bytes(), "").is_ok());
    let coarse = Written {
        length: |v| format!("{v:.0}"),
        ..Written::default()
    }
    .text();
    let (_, rows) = coarse.split_once('\n').unwrap();
    assert!(read(format!("{coarse}{rows}").as_bytes(), "").is_ok());
}

#[test]
fn pulses_of_motors_are_no_degrees() {
    let pulses = |per_deg: f64, name: fn(usize) -> String| {
        let rows: String = truth()
            .iter()
            .map(|(q, p)| {
                let q = q.map(|q| format!("{:.0}", q * per_deg)).join(",");
                format!("{q},{}\n", p.map(four).join(","))
            })
            .collect();
        format!("{}\n{rows}", header(name, MM).join(","))
    };
    let name = |j: usize| format!("J{j} [deg]");
    let hint = "pulses of motors or counts of encoders, convert them";
    refused_as("pulses", &pulses(1341.4, name), "out_of_range", hint);
    let few = pulses(4096.0 / 360.0, name);
    refused_as(
        "few pulses",
        &few,
        "out_of_range",
        "6 joints turn more than twice",
    );
    refused_as("few pulses", &few, "out_of_range", hint);
    let unit = pulses(4096.0 / 360.0, |j| format!("J{j}"));
    let error = read(unit.as_bytes(), "\"joint_unit\": \"deg\"").unwrap_err();
    assert!(error.issues[0].detail.contains(hint), "{error:?}");
    // One joint may turn often.
    let rows: String = (0..9)
        .map(|row| format!("1,2,3,4,5,{},{row}.25,2.5,3.75\n", 360 * row))
        .collect();
    let text = format!("{}\n{rows}", own_header().join(","));
    assert!(read(text.as_bytes(), "").is_ok());
}

#[test]
fn a_cell_too_many_moves_no_number_into_another_column() {
    let table = with_remarks(|_| vec![String::new()]);
    // a name with a separator in it, in a file with empty remarks
    let text = table.text().replace("P3,", "P,3,");
    refused_as("a name", &text, "wrong_cell_count", "row 2 has 12 cells");
    // The remark of that row is left out.
    let table = with_remarks(|row| vec![if row == 2 { "" } else { "ok" }.into()]);
    let text = table.text().replace("P3,", "P,3,").replace(",\n", "\n");
    refused_as(
        "among texts",
        &text,
        "wrong_cell_count",
        "row 2, column Remark",
    );
    // A header without a name over the numbers of the rows, as R writes it.
    let mut table = with_remarks(|_| vec![String::new()]);
    table.header.remove(0);
    table.front = |row| vec![(row + 1).to_string()];
    refused_as(
        "numbers of rows",
        &table.text(),
        "two_readings",
        "J1 [deg] numbers the rows",
    );
    let mut named = table.text();
    named.insert_str(0, "Row,");
    is_read("with a name", &named);
    // Rows that all end with a separator are read.
    let table = with_remarks(|_| vec!["ok".into()]);
    let (names, rows) = table
        .text()
        .split_once('\n')
        .map(|(a, b)| (a.to_owned(), b.replace('\n', ",\n")))
        .unwrap();
    is_read("separators at the ends", &format!("{names}\n{rows}"));
}

#[test]
fn a_last_number_that_was_cut_off_is_refused() {
    let text = named_rows().text();
    is_read("without a line end", text.trim_end());
    refused_as(
        "cut off",
        &text[..text.len() - 3],
        "wrong_cell_count",
        "was it cut off?",
    );
    is_read("not cut off", &(text.trim_end().to_owned() + "\n"));
}

#[test]
fn cells_in_quotes_behind_spaces_are_read() {
    let text = named_rows().text();
    let lines = text.lines().map(|line| {
        let cells: Vec<String> = line.split(',').map(|cell| format!("\"{cell}\"")).collect();
        cells.join(", ") + "\n"
    });
    is_read("quotes behind spaces", &lines.collect::<String>());
}

#[test]
fn rows_of_workbooks_may_end_before_columns_that_are_not_read() {
    let mut cells = vec![with_remarks(none).header];
    cells.extend(with_remarks(none).rows());
    cells[0].push("Temperature".into());
    cells[3].extend(["warm".to_owned(), "21.5".to_owned()]);
    for bytes in [
        workbooks::xlsx(&[("Sheet1", &cells)]),
        workbooks::ods(&[("Sheet1", &cells)]),
    ] {
        let (set, _) = read(&bytes, "").unwrap();
        is_true("a workbook", &set);
    }
}

#[test]
fn names_in_another_encoding_say_what_to_do() {
    // The header of a table in GBK.
    let rows = Written::default().text();
    let (_, rows) = rows.split_once('\n').unwrap();
    let mut bytes = b"\xB9\xD8\xBD\xDA1,\xB9\xD8\xBD\xDA2,\xB9\xD8\xBD\xDA3,\xB9\xD8\xBD\xDA4,\xB9\xD8\xBD\xDA5,\xB9\xD8\xBD\xDA6,X [mm],Y [mm],Z [mm]\n".to_vec();
    bytes.extend(rows.as_bytes());
    let error = read(&bytes, "").unwrap_err();
    assert!(
        error.issues[0].detail.contains("save it as CSV in UTF-8"),
        "{error:?}"
    );
}

#[test]
fn remarks_of_any_signs_never_change_what_was_measured() {
    let mut seed = 1u64;
    let mut random = move |below: usize| {
        // Knuth's linear congruential generator
        seed = seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) as usize % below
    };
    // not #: a row that begins with it is a row that was left out
    let signs = [
        "\"", "\"", "\"\"", "a", "1", " ", ",", ";", "\n", "\r\n", "5\"",
    ];
    let (mut n_read, mut n_refused) = (0, 0);
    for _ in 0..3000 {
        let is_in_front = random(2) == 0;
        let separator = [",", ";", "\t"][random(3)];
        let table = Written {
            separator,
            ..named_rows()
        };
        let lines = table.text();
        let mut lines = lines.lines();
        let mut text = match is_in_front {
            true => format!("Remark{separator}{}\n", lines.next().unwrap()),
            false => format!("{}{separator}Remark\n", lines.next().unwrap()),
        };
        for line in lines {
            let remark: String = match random(3) {
                0 => (0..random(5)).map(|_| signs[random(signs.len())]).collect(),
                _ => String::new(),
            };
            // as a spreadsheet writes it, or as a person does
            let remark = match random(2) {
                0 => format!("\"{}\"", remark.replace('"', "\"\"")),
                _ => remark,
            };
            text += &match is_in_front {
                true => format!("{remark}{separator}{line}\n"),
                false => format!("{line}{separator}{remark}\n"),
            };
        }
        match read(text.as_bytes(), "") {
            Ok((set, reading)) => {
                is_true(&text, &set);
                is_read_again(&text, text.as_bytes(), &set, &reading.unwrap());
                n_read += 1;
            }
            Err(_) => n_refused += 1,
        }
    }
    println!("{n_read} tables read, {n_refused} refused");
    assert!(n_read > 1500, "{n_read} of 3000");
}

#[test]
fn an_upload_of_an_earlier_version_is_read_as_it_was() {
    let table =
        with_remarks(|row| vec![if row == 3 { "\"1, 2, 3\n4, 5, 6\"" } else { "" }.to_owned()]);
    refused_as(
        "a cell like a row",
        &table.text(),
        "two_readings",
        "line 5 has a quote",
    );
    let plain = with_remarks(|_| vec![String::new()]).text();
    let (mut set, reading) = read(plain.as_bytes(), "").unwrap();
    // the cell with a line break moves the rows below it
    for point in &mut set.points[4..] {
        point.line = point.line.map(|line| line + 1);
    }
    is_read_again("stored", table.text().as_bytes(), &set, &reading.unwrap());
}

#[test]
fn a_row_without_a_number_is_refused_if_a_label_is_read_last() {
    let mut table = Written {
        header: own_header()
            .into_iter()
            .chain(["configuration".to_owned(), "remark".to_owned()])
            .collect(),
        back: |row| vec![(row + 17).to_string(), "ok".into()],
        ..Written::default()
    };
    is_read("whole", &table.text());
    let text = table.text();
    let row = text.lines().nth(3).unwrap();
    let cells: Vec<&str> = row.split(',').collect();
    let without_y = [&cells[..7], &cells[8..]].concat().join(",");
    refused_as(
        "without y",
        &text.replace(row, &without_y),
        "wrong_cell_count",
        "row 2",
    );
    table.header.truncate(10);
    table.back = |row| vec![(row + 17).to_string()];
    is_read("without remarks", &table.text());
}

#[test]
fn a_target_name_of_another_instrument_is_the_name_of_a_point() {
    use kincal::measurement::columns::mapping::{Mapping, Needs};
    use kincal::measurement::table::points::{TableOptions, read};
    use kincal::measurement::table::text::Source;
    for header in [
        "Target_Name,X [mm],Y [mm],Z [mm]",
        "target_name,x_mm,y_mm,z_mm",
    ] {
        let text = format!("{header}\nP1,1,2,3\nP2,4,5,7\nP1,1,2,3.01\n");
        let options = TableOptions {
            mapping: &Mapping::default(),
            n_joints: 6,
            needs: Needs::Positions,
            rotation: None,
            is_time: |_| true,
            are_targets: false,
        };
        let content = read(Source::decode(text.as_bytes()).unwrap(), &options).unwrap();
        assert_eq!(content.keys[0].1, ["P1", "P2", "P1"], "{header}");
        assert!(content.points.iter().all(|point| point.target == 0));
    }
}
