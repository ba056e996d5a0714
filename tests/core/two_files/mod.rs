//! The robot's file and the instrument's are joined to what was measured, or refused with what to state. The examples are written by us in the layouts
//! of the makers (examples/tables).

mod names;
mod times;

use kincal::measurement::Frame;
use kincal::wire::Invalid;
use kincal::wire::columns::ColumnsBody;
use kincal::wire::measurement::{MeasurementSet, Upload, from_file, from_upload};
use kincal::wire::understood::{JoinedFiles, Reading};
use std::collections::BTreeMap;

/// Angles are written with four decimals of a degree, and nine of a radian; positions with four of a millimetre.
const ROUNDING: f64 = 1e-6;

fn example(name: &str) -> Vec<u8> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/tables");
    std::fs::read(folder.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

const BOUNDARY: &str = "multipart/form-data; boundary=b";

fn form(robot: &[u8], instrument: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    for (name, bytes) in [("robot", robot), ("instrument", instrument)] {
        body.extend_from_slice(
            format!("--b\r\nContent-Disposition: form-data; name=\"{name}\"\r\n\r\n").as_bytes(),
        );
        body.extend_from_slice(bytes);
        body.extend_from_slice(b"\r\n");
    }
    body.extend_from_slice(b"--b--\r\n");
    body
}

fn read(body: &[u8], columns: &str) -> Result<(MeasurementSet, Option<Reading>), Invalid> {
    let columns = match columns {
        "" => ColumnsBody::default(),
        columns => ColumnsBody::parse(columns.as_bytes())?,
    };
    let upload = Upload {
        content_type: BOUNDARY,
        bytes: body,
        columns: &columns,
        decimal: None,
        rotation: None,
        frame: Frame::Base,
        instrument: None,
    };
    from_file(&upload, 6)
}

fn refusal(robot: &str, instrument: &str, columns: &str) -> (String, String) {
    let error = read(&form(robot.as_bytes(), instrument.as_bytes()), columns).unwrap_err();
    (error.issues[0].code.clone(), error.issues[0].detail.clone())
}

/// Joint values (degrees, whole ten-thousandths) and what belongs to them.
fn truth() -> BTreeMap<[i64; 6], [f64; 3]> {
    let text = String::from_utf8(example("truth.csv")).unwrap();
    text.lines()
        .skip(1)
        .map(|line| {
            let numbers: Vec<f64> = line
                .split(',')
                .skip(1)
                .map(|cell| cell.parse().unwrap())
                .collect();
            (
                std::array::from_fn(|i| (numbers[i] * 10_000.0).round() as i64),
                std::array::from_fn(|i| numbers[6 + i]),
            )
        })
        .collect()
}

/// Every pair is one that was measured, in the values of both files; returns how they were joined.
fn joined(robot: &str, instrument: &str, columns: &str, n: usize) -> JoinedFiles {
    let body = form(&example(robot), &example(instrument));
    let name = format!("{robot} and {instrument}");
    let (set, reading) = read(&body, columns).unwrap_or_else(|e| panic!("{name}: {e:?}"));
    let truth = truth();
    assert_eq!(set.points.len(), n, "{name}");
    for point in &set.points {
        let key = std::array::from_fn(|i| (point.q_rad[i].to_degrees() * 10_000.0).round() as i64);
        let meant = truth
            .get(&key)
            .unwrap_or_else(|| panic!("{name}: {key:?} was never measured"));
        for (found, meant) in point.position_mm.iter().zip(meant) {
            assert!(
                (found - meant).abs() < ROUNDING,
                "{name}: {found} for {meant} mm"
            );
        }
    }
    let reading = reading.unwrap();
    let json = serde_json::to_string(&reading).unwrap();
    let again = from_upload(BOUNDARY, Some(&json), &body, Frame::Base, 6).unwrap();
    assert!(again == set, "{name}: read again");
    reading.joined.unwrap()
}

fn columns_of(names: &[&str]) -> String {
    let mut all = serde_json::Map::new();
    for name in names {
        let text = example(&format!("columns_{name}.json"));
        let columns: serde_json::Map<String, serde_json::Value> =
            serde_json::from_slice(&text).unwrap();
        all.extend(columns);
    }
    serde_json::Value::Object(all).to_string()
}

#[test]
fn programs_and_logs_of_robots_join_with_exports_of_instruments() {
    let robots = [
        ("robot_kuka.dat", None),
        ("robot_abb.mod", None),
        ("robot_fanuc.ls", None),
        ("robot_yaskawa.txt", Some("yaskawa")),
    ];
    let instruments = [
        (
            "instrument_spatialanalyzer.txt",
            Some("spatialanalyzer"),
            15,
            "name",
        ),
        ("instrument_polyworks.txt", Some("polyworks"), 16, "name"),
        ("instrument_leica.csv", None, 16, "name"),
        ("instrument_faro.csv", Some("faro"), 16, "name"),
        ("instrument_vicon.csv", Some("vicon"), 16, "order"),
    ];
    for (robot, robot_columns) in robots {
        for (instrument, columns, n, by) in instruments {
            let names: Vec<&str> = robot_columns.into_iter().chain(columns).collect();
            let found = joined(robot, instrument, &columns_of(&names), n);
            assert_eq!(found.join.by, by);
            assert_eq!(found.join.n_joined, n);
            let (theirs, ours) = (&found.join.leftover_instrument, &found.join.leftover_robot);
            assert_eq!((ours.n, theirs.n), if n == 15 { (1, 1) } else { (0, 0) });
            if n == 15 {
                assert_eq!(
                    (ours.rows[0].label.as_str(), theirs.rows[0].label.as_str()),
                    ("P5", "DRIFT_1")
                );
            }
        }
    }
}

#[test]
fn a_log_joins_by_time_though_the_clocks_differ_and_the_robot_moves_between() {
    let found = joined(
        "robot_ur_rtde.csv",
        "instrument_optitrack.csv",
        &columns_of(&["optitrack"]),
        16,
    );
    assert_eq!(found.join.by, "time");
    let offset_s = found.join.clock_offset_s.unwrap();
    // half of the shortest standstill: the times are in its middle
    assert!((offset_s - 4990.5).abs() < 0.25, "{offset_s}");
}

/// A rigid body has the components of a quaternion under X, Y, Z and W, and its position under the same X, Y and Z.
#[test]
fn the_position_of_a_rigid_body_is_not_its_rotation() {
    let postures = [
        [10.0, 1.0],
        [20.0, 2.0],
        [30.0, 3.0],
        [40.0, 5.0],
        [50.0, 8.0],
    ];
    let log: String = postures
        .iter()
        .map(|[q, t]| format!("{t};{q};2;3;4;5;6\n"))
        .collect();
    let robot = format!("time [s];J1 [deg];J2 [deg];J3 [deg];J4 [deg];J5 [deg];J6 [deg]\n{log}");
    let frames: String = postures
        .iter()
        .map(|[q, t]| {
            format!(
                "{},{t},0.1,0.2,0.3,0.927,{},2.5,0.75,0.0001\n",
                120.0 * t,
                q / 10.0
            )
        })
        .collect();
    let instrument = format!(
        "Format Version,1.23,Take Name,T,Rotation Type,Quaternion,Length Units,Meters\n\n,,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid \
         Body,Rigid Body,Rigid Body,Rigid Body\n,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error\nFrame,Time \
         (Seconds),X,Y,Z,W,X,Y,Z,\n{frames}"
    );
    let (set, _) = read(&form(robot.as_bytes(), instrument.as_bytes()), "").unwrap();
    let measured: Vec<f64> = set.points.iter().map(|p| p.position_mm.x).collect();
    let expected = postures.map(|[q, _]| 100.0 * q);
    assert_eq!(measured.len(), expected.len());
    for (measured, expected) in measured.iter().zip(expected) {
        assert!((measured - expected).abs() < 1e-9, "{measured} {expected}");
    }
}

#[test]
fn what_cannot_be_joined_says_what_to_state() {
    let robot = |rows: &str| {
        format!("Point;time [s];J1 [deg];J2 [deg];J3 [deg];J4 [deg];J5 [deg];J6 [deg]\n{rows}")
    };
    let row = |name: &str, time: f64, q: f64| format!("{name};{time};{q};2;3;4;5;6\n");
    let even: String = (0..12)
        .map(|i| row(&format!("R{i}"), 10.0 * f64::from(i), f64::from(i)))
        .collect();
    let instrument = |n: i32| -> String {
        let rows: String = (0..n)
            .map(|i| format!("{},{i},2,3\n", 5000.0 + 10.0 * f64::from(i)))
            .collect();
        format!("time [s],x_mm,y_mm,z_mm\n{rows}")
    };
    let (code, detail) = refusal(&robot(&even), &instrument(8), "");
    assert_eq!(code, "two_readings", "{detail}");
    assert!(detail.contains("clock_offset_s"), "{detail}");
    // all of them, none recommended
    for offset in [-5000, -4990, -4980, -4970, -4960] {
        let named = format!("{offset}.000 s (8 pairs)");
        assert!(detail.contains(&named), "no {named}: {detail}");
    }
    assert!(
        detail.contains("{\"join\": {\"clock_offset_s\": \"SECONDS\"}}"),
        "{detail}"
    );
    // clocks that may agree are no exception: the first posture may be the one that was not measured
    let as_they_are: String = (0..8).map(|i| format!("{}.5,{i},2,3\n", 10 * i)).collect();
    let (code, detail) = refusal(
        &robot(&even),
        &format!("time [s],x_mm,y_mm,z_mm\n{as_they_are}"),
        "",
    );
    assert_eq!(code, "two_readings", "{detail}");
    assert!(detail.contains("-0.500 s (8 pairs)"), "{detail}");
    // a long file that is as even: the differences are counted, not all kept
    let long: String = (0..5000)
        .map(|i| row(&format!("R{i}"), f64::from(i), f64::from(i % 90)))
        .collect();
    let rows: String = (0..200)
        .map(|i| format!("{},{i},2,3\n", 9000.0 + f64::from(i)))
        .collect();
    let instrument_file = format!("time [s],x_mm,y_mm,z_mm\n{rows}");
    let (code, detail) = refusal(&robot(&long), &instrument_file, "");
    assert_eq!(code, "two_readings", "{detail}");
    assert!(detail.contains(" and at least 181 more"), "{detail}");
    // with as many rows on both sides there is one reading only
    let all = read(
        &form(robot(&even).as_bytes(), instrument(12).as_bytes()),
        "",
    )
    .unwrap()
    .0;
    assert!(
        all.points
            .iter()
            .all(|point| (point.q_rad[0].to_degrees() - point.position_mm.x).abs() < ROUNDING)
    );
    // stated
    let stated = "{\"join\": {\"clock_offset_s\": -4980}}";
    let some = read(
        &form(robot(&even).as_bytes(), instrument(8).as_bytes()),
        stated,
    )
    .unwrap()
    .0;
    assert!(
        some.points.iter().all(
            |point| (point.q_rad[0].to_degrees() - point.position_mm.x - 2.0).abs() < ROUNDING
        )
    );
    let twice = robot(&(row("A", 0.0, 1.0) + row("A", 1.0, 9.0).as_str()));
    let (code, detail) = refusal(&twice, "name,x_mm,y_mm,z_mm\nA,1,2,3\n", "");
    assert_eq!(code, "duplicate_name");
    assert!(detail.contains("lines 2 and 3"), "{detail}");
    let (code, detail) = refusal(&robot(&even), "x_mm,y_mm,z_mm\n1,2,3\n", "");
    assert_eq!(code, "join_unclear");
    assert!(detail.contains("\"by\": \"order\""), "{detail}");
    let (code, detail) = refusal(&robot(&even), "time,x_mm,y_mm,z_mm\n12,1,2,3\n", "");
    assert_eq!(code, "not_a_time");
    assert!(
        detail.contains("{\"instrument\": {\"time_s\": \"COLUMN\"}} (milliseconds are time_ms)"),
        "{detail}"
    );
    let stated = "{\"instrument\": {\"time_ms\": \"time\"}, \"join\": {\"clock_offset_s\": 0, \"tolerance_s\": 1}}";
    let milliseconds = "time,x_mm,y_mm,z_mm\n10000,1,2,3\n20000,1,2,3\n";
    let (set, _) = read(
        &form(robot(&even).as_bytes(), milliseconds.as_bytes()),
        stated,
    )
    .unwrap();
    assert!((set.points[1].q_rad[0].to_degrees() - 2.0).abs() < ROUNDING);
    // numbers and names that say different things
    let both = "Point;No.;J1 [deg];J2 [deg];J3 [deg];J4 [deg];J5 [deg];J6 [deg]\nA;1;1;2;3;4;5;6\nB;2;9;2;3;4;5;6\n";
    let (code, _) = refusal(both, "Point,No.,x_mm,y_mm,z_mm\nA,2,1,2,3\nB,1,1,2,3\n", "");
    assert_eq!(code, "two_readings");
}

#[test]
fn a_fault_names_its_file() {
    let robot = "Point,J1 [deg],J2 [deg],J3 [deg],J4 [deg],J5 [deg],J6 [deg]\nA,1,2,3,4,5,6\n";
    let error = read(
        &form(robot.as_bytes(), b"Point,x_mm,y_mm,z_mm\nA,1,?,3\n"),
        "",
    )
    .unwrap_err();
    let issue = &error.issues[0];
    assert_eq!(
        (issue.pointer.as_deref(), issue.row, issue.line),
        (Some("/instrument"), Some(0), Some(2))
    );
    assert!(
        issue.detail.starts_with("instrument file: row 0"),
        "{issue:?}"
    );
}

const LOG: &str = "Point,J1 [deg],J2 [deg],J3 [deg],J4 [deg],J5 [deg],J6 [deg]\n";

/// A robot's file with the points `name(1)` …, each with joint 1 at its number.
fn log(n: usize, name: impl Fn(usize) -> String) -> String {
    let rows = (1..=n).map(|i| format!("{},{i},2,3,4,5,6\n", name(i)));
    LOG.to_owned() + &rows.collect::<String>()
}

/// An instrument's file with x at ten times the point's number, 100 mm apart in y.
fn export(header: &str, n: usize, name: impl Fn(usize) -> String) -> String {
    let rows = (1..=n).map(|i| format!("{},{},{},3\n", name(i), 10 * i, 100 * i));
    format!("{header},x_mm,y_mm,z_mm\n") + &rows.collect::<String>()
}

fn belongs(robot: &str, instrument: &str, n: usize) -> JoinedFiles {
    let body = form(robot.as_bytes(), instrument.as_bytes());
    let (set, reading) = read(&body, "").unwrap_or_else(|e| panic!("{e:?}\n{instrument}"));
    assert_eq!(set.points.len(), n);
    for point in &set.points {
        let number = point.q_rad[0].to_degrees();
        assert!((10.0 * number - point.position_mm.x).abs() < ROUNDING * 100.0);
    }
    let reading = reading.unwrap();
    let json = serde_json::to_string(&reading).unwrap();
    let again = from_upload(BOUNDARY, Some(&json), &body, Frame::Base, 6).unwrap();
    assert!(again == set);
    reading.joined.unwrap()
}

#[test]
fn one_name_with_positions_far_apart_is_refused() {
    let p = |i: usize| format!("P{i}");
    let robot = log(12, p);
    let twice = |row: &str| export("Name", 12, p) + row;
    // the same group measured again
    let body = form(robot.as_bytes(), twice("P3,30.01,300,3\n").as_bytes());
    assert_eq!(read(&body, "").unwrap().0.points.len(), 13);
    // a reference with the name of a point, and a second reflector
    let (code, detail) = refusal(&robot, &twice("P3,5000,2,3\n"), "");
    assert_eq!(code, "duplicate_name");
    assert!(detail.contains("lines 4 and 14"), "{detail}");
    let with_target = twice("P3,5000,2,3\n")
        .replace("\nP", ",0\nP")
        .replace("z_mm,0", "z_mm,target");
    let with_target = with_target.replace("P3,5000,2,3\n", "P3,5000,2,3,1\n");
    let body = form(robot.as_bytes(), with_target.as_bytes());
    assert_eq!(read(&body, "").unwrap().0.points.len(), 13, "{with_target}");
}

#[test]
fn names_that_differ_in_signs_and_zeros_are_one() {
    let robot = log(12, |i| format!("P{i}"));
    for name in ["P_0", "p 00", "P-"] {
        let found = belongs(&robot, &export("Name", 12, |i| format!("{name}{i}")), 12);
        assert!(found.join.loose_names, "{name}");
    }
    let foreign = export("Target", 12, |i| format!("P{i}"));
    let foreign = foreign.replace("x_mm,y_mm,z_mm", "X [mm],Y [mm],Z [mm]");
    let found = belongs(&robot, &foreign, 12);
    assert!(!found.join.loose_names);
    assert_eq!(found.instrument.columns[0].means, "name");
    let found = belongs(&robot, &export("PointID", 11, |i| format!("P{i}")), 11);
    assert_eq!(found.join.leftover_robot.n, 1);
    // one file numbers what the other names
    let numbered = log(12, |i| i.to_string()).replace("Point,", "No.,");
    let found = belongs(&numbered, &export("Name", 12, |i| format!("{i:03}")), 12);
    assert!(found.join.loose_names);
    let found = belongs(&robot, &export("Name", 12, |i| format!("Point {i}")), 12);
    assert!(found.join.loose_names);
    let letter = |i: usize| format!("corner {}", char::from(b'a' + i as u8));
    let (_, detail) = refusal(&robot, &export("Name", 12, letter), "");
    assert!(
        detail.contains("\"P1\", \"P2\"") && detail.contains("\"corner "),
        "{detail}"
    );
    // P1_2 is not P12
    let parts = log(2, |i| format!("P1_{i}"));
    let (code, _) = refusal(&parts, &export("Name", 2, |i| format!("P1{i}")), "");
    assert_eq!(code, "join_unclear");
}

#[test]
fn exchanged_and_single_files_are_told_so() {
    let p = |i: usize| format!("P{i}");
    let (robot, instrument) = (log(3, p), export("Name", 3, p));
    for (first, second) in [
        (&instrument, &robot),
        (&robot, &robot),
        (&instrument, &instrument),
    ] {
        let (_, detail) = refusal(first, second, "");
        assert!(detail.contains("exchanged"), "{detail}");
    }
    for file in [&robot, &instrument] {
        let columns = ColumnsBody::default();
        let upload = Upload {
            content_type: "text/csv",
            bytes: file.as_bytes(),
            columns: &columns,
            decimal: None,
            rotation: None,
            frame: Frame::Base,
            instrument: None,
        };
        let error = from_file(&upload, 6).unwrap_err();
        assert_eq!(error.issues.len(), 1);
        assert!(
            error.issues[0].detail.contains("give both files"),
            "{error:?}"
        );
    }
}

#[test]
fn times_of_half_a_day_and_dates_with_slashes_are_read_where_they_have_one_meaning() {
    let robot = |date: &dyn Fn(usize) -> &'static str| {
        let rows = (1..=8).map(|i| {
            format!(
                "{}1:{:02}:{:02} PM,{i},2,3,4,5,6\n",
                date(i),
                7 * i,
                i * i % 60
            )
        });
        LOG.replace("Point", "Time") + &rows.collect::<String>()
    };
    let rows = (1..=8).map(|i| {
        format!(
            "13:{:02}:{:02},{},{},3\n",
            7 * i,
            i * i % 60,
            10 * i,
            100 * i
        )
    });
    let instrument = "Time,x_mm,y_mm,z_mm\n".to_owned() + &rows.collect::<String>();
    assert_eq!(belongs(&robot(&|_| ""), &instrument, 8).join.by, "time");
    assert_eq!(
        belongs(&robot(&|_| "03/04/2026 "), &instrument, 8).join.by,
        "time"
    );
    let two_days = robot(&|i| if i < 5 { "03/04/2026 " } else { "03/05/2026 " });
    let (code, detail) = refusal(&two_days, &instrument, "");
    assert_eq!(code, "not_a_time");
    assert!(detail.contains("slashes"), "{detail}");
}

#[test]
fn of_an_instruments_log_the_standstills_count() {
    // ten times a second: a second of motion, then a standstill, each of another length
    let (mut robot, mut stream) = (
        LOG.replace("Point", "time [s]"),
        "time [s],x_mm,y_mm,z_mm\n".to_owned(),
    );
    let mut tenths = 0;
    for i in 1..=8_i32 {
        for step in 0..40 + 7 * i % 19 {
            let part = f64::from(step.min(10)) / 10.0;
            let at = f64::from(i - 1) + part;
            let time_s = f64::from(tenths) / 10.0;
            robot += &format!("{time_s:.1},{at},2,3,4,5,6\n");
            stream += &format!("{:.1},{},{},3\n", time_s + 500.0, 10.0 * at, 100.0 * at);
            tenths += 1;
        }
    }
    let found = belongs(&robot, &stream, 8);
    assert!(found.join.instrument_log);
    assert_eq!(found.join.leftover_instrument.n, 0);
}

#[test]
fn names_with_the_same_numbers_pair_if_no_number_is_missing_or_doubled() {
    let robot = |names: [&str; 3]| {
        let rows = names
            .iter()
            .zip(1..)
            .map(|(name, i)| format!("{name};{i};2;3;4;5;6\n"));
        let rows: String = rows.collect();
        format!("Point;J1 [deg];J2 [deg];J3 [deg];J4 [deg];J5 [deg];J6 [deg]\n{rows}")
    };
    let instrument = |header: &str, names: [&str; 3]| {
        let rows = names.iter().map(|name| format!("{name},1,2,3\n"));
        let rows: String = rows.collect();
        format!("{header},x_mm,y_mm,z_mm\n{rows}")
    };
    let points = ["P1", "P2", "P3"];
    for (ours, header, theirs) in [
        (points, "No.", ["3", "2", "1"]),
        (points, "Point", ["Point 3", "Point 2", "Point 1"]),
        (["XP1", "XP2", "XP3"], "Point", ["P03", "P02", "P01"]),
    ] {
        let (ours, theirs) = (robot(ours), instrument(header, theirs));
        let (set, reading) = read(&form(ours.as_bytes(), theirs.as_bytes()), "").unwrap();
        assert!((set.points[0].q_rad[0].to_degrees() - 3.0).abs() < ROUNDING);
        let join = reading.unwrap().joined.unwrap().join;
        assert_eq!((join.by.as_str(), join.loose_names), ("name", true));
    }
    for theirs in [["T1", "M1", "T2"], ["T1", "T2", "HOME"]] {
        let (code, _) = refusal(&robot(points), &instrument("Point", theirs), "");
        assert_eq!(code, "join_unclear", "{theirs:?}");
    }
}

#[test]
fn an_instruments_table_that_stands_twice_is_refused() {
    let text = |name: &str| String::from_utf8_lossy(&example(name)).into_owned();
    let (robot, instrument) = (text("robot_kuka.dat"), text("instrument_leica.csv"));
    let n_lines = instrument.lines().count();
    let rows: String = (instrument.lines().skip(n_lines - 16))
        .map(|row| format!("{row}\n"))
        .collect();
    let (code, detail) = refusal(&robot, &format!("{}\n{rows}", instrument.trim_end()), "");
    assert_eq!(code, "rows_twice", "{detail}");
    let hint = format!(
        "line {} of the instrument's file agrees with line {}",
        n_lines + 1,
        n_lines - 15
    );
    assert!(detail.contains(&hint), "{detail}");
}

#[test]
fn a_wrong_clock_difference_is_told_with_the_one_that_the_times_show() {
    let times_s = [0.0, 7.0, 19.0, 24.0, 40.0, 51.0];
    let mut robot =
        String::from("time [s],J1 [deg],J2 [deg],J3 [deg],J4 [deg],J5 [deg],J6 [deg]\n");
    let mut instrument = String::from("time [s],x_mm,y_mm,z_mm\n");
    for (i, time_s) in times_s.iter().enumerate() {
        robot += &format!("{},{i},2,3,4,5,6\n", 500.0 + time_s);
        instrument += &format!("{},{i},2,3\n", 410.5 + time_s);
    }
    for by in ["", "\"by\": \"time\", "] {
        let stated = format!("{{\"join\": {{{by}\"clock_offset_s\": 900}}}}");
        let (code, detail) = refusal(&robot, &instrument, &stated);
        assert_eq!(code, "join_unclear");
        assert!(
            detail.contains("900 s, 0 of 6 rows pair")
                && detail.contains("show 89.5 s, which pairs 6 rows")
                && detail.contains("{\"join\": {\"clock_offset_s\": 89.5}}"),
            "{detail}"
        );
    }
}

#[test]
fn the_timestamp_of_a_log_of_universal_robots_is_in_seconds() {
    let mut robot = String::from(
        "timestamp actual_q_0 actual_q_1 actual_q_2 actual_q_3 actual_q_4 actual_q_5\n",
    );
    let mut instrument = String::from("time [s],x_mm,y_mm,z_mm\n");
    for (i, time_s) in [0.0, 7.0, 19.0, 24.0, 40.0, 51.0].iter().enumerate() {
        robot += &format!("{} 0.{i} 0.2 0.3 0.4 0.5 0.6\n", 500.0 + time_s);
        instrument += &format!("{},{i},2,3\n", 410.5 + time_s);
    }
    let (set, _) = read(&form(robot.as_bytes(), instrument.as_bytes()), "").unwrap();
    assert_eq!(set.points.len(), 6);
    // without its joint values a time has no unit
    let mut other = robot;
    for (axis, joint) in (0..6).zip(1..) {
        other = other.replace(&format!("actual_q_{axis}"), &format!("q{joint}_rad"));
    }
    let (_, detail) = refusal(&other, &instrument, "");
    assert!(detail.contains("has no unit"), "{detail}");
}

#[test]
fn an_export_without_header_is_read_by_numbers_beside_a_robots_file_with_one() {
    let robot = log(6, |i| format!("P{i}"));
    let rows: String = (1..=6)
        .map(|i| format!("Cell,Cal,P{i},{i}.5,2.5,3.5\n"))
        .collect();
    let (code, detail) = refusal(&robot, &rows, "");
    assert_eq!(code, "no_header");
    assert!(
        detail.starts_with("instrument file")
            && detail
                .contains("{\"x_mm\": 4, \"y_mm\": 5, \"z_mm\": 6, \"instrument\": {\"name\": 3}}")
            && !detail.contains("q1_deg"),
        "{detail}"
    );
    // numbers in quotes are numbers where no column has a name
    for [name, x] in [["3", "4"], ["\"3\"", "\"4\""]] {
        let by_number = format!(
            "{{\"instrument\": {{\"header_row\": false, \"name\": {name}}}, \"x_mm\": {x}, \"y_mm\": 5, \"z_mm\": 6}}"
        );
        let (set, _) = read(&form(robot.as_bytes(), rows.as_bytes()), &by_number).unwrap();
        assert_eq!(set.points.len(), 6);
    }
    let for_both = "{\"header_row\": false, \"instrument\": {\"name\": 3}, \"x_mm\": 4, \"y_mm\": 5, \"z_mm\": 6}";
    let (_, detail) = refusal(&robot, &rows, for_both);
    assert!(
        detail.starts_with("robot file")
            && detail.contains("{\"instrument\": {\"header_row\": false}}"),
        "{detail}"
    );
    let (_, detail) = refusal(
        &robot,
        "Point,x_mm,y_mm,z_mm\nP1,1,2,3\n",
        "{\"x_mm\": \"2\"}",
    );
    assert!(
        detail.contains("a column's number goes without quotes: 2"),
        "{detail}"
    );
}

#[test]
fn a_point_has_the_name_and_the_line_that_it_has_in_its_file() {
    let robot = log(12, |i| format!("P{i}"));
    let instrument = export("Name", 12, |i| format!("p_0{i}"));
    let instrument = instrument.replacen("p_01,", "# a comment\np_01,", 1);
    let body = form(robot.as_bytes(), instrument.as_bytes());
    let (set, _) = read(&body, "").unwrap();
    for (row, point) in set.points.iter().enumerate() {
        assert_eq!(
            point.name.as_deref(),
            Some(format!("P{}", row + 1).as_str())
        );
        assert_eq!(point.line, Some(row + 3));
        // what belongs together is decided without the name
        assert_eq!(point.configuration, format!("row_{row}"));
    }
    let numbered = log(12, |i| i.to_string()).replace("Point,", "No.,");
    let body = form(
        numbered.as_bytes(),
        export("No.", 12, |i| i.to_string()).as_bytes(),
    );
    let (set, _) = read(&body, "").unwrap();
    assert_eq!(set.points[4].name.as_deref(), Some("5"));
}

#[test]
fn numbers_in_names_pair_if_the_caller_says_so_and_the_rest_is_left_over() {
    let robot = log(12, |i| format!("P{i}"));
    let more = "DRIFT_1,815.2,-40.7,303.9\nHOME,-77.1,912.4,66.6\nPoint 40,431.8,-222.3,518.4\nPoint 41,-640.5,91.2,733.1\n";
    let instrument = export("Name", 12, |i| format!("Point {i}")) + more;
    let (code, detail) = refusal(&robot, &instrument, "");
    assert_eq!(code, "join_unclear");
    assert!(
        detail.contains("{\"join\": {\"by\": \"number\"}}"),
        "{detail}"
    );
    let body = form(robot.as_bytes(), instrument.as_bytes());
    let (set, reading) = read(&body, "{\"join\": {\"by\": \"number\"}}").unwrap();
    assert_eq!(set.points.len(), 12);
    assert!(
        set.points
            .iter()
            .all(|p| (10.0 * p.q_rad[0].to_degrees() - p.position_mm.x).abs() < 1e-4)
    );
    let json = serde_json::to_string(&reading).unwrap();
    let again = from_upload(BOUNDARY, Some(&json), &body, Frame::Base, 6).unwrap();
    assert!(again == set);
    let left = reading.unwrap().joined.unwrap().join.leftover_instrument;
    let labels: Vec<&str> = left.rows.iter().map(|row| row.label.as_str()).collect();
    assert_eq!(labels, ["DRIFT_1", "HOME", "Point 40", "Point 41"]);
    // more rows than the robot's file: by order the refusal says what to state
    let (_, detail) = refusal(&robot, &instrument, "{\"join\": {\"by\": \"order\"}}");
    assert!(detail.contains("by a column that both have"), "{detail}");
}
