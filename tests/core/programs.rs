//! Robot programs as measurement files: what is read, what is listed as not read, and what is refused.

use kincal::measurement::Frame;
use kincal::wire::columns::ColumnsBody;
use kincal::wire::measurement::{Upload, from_file, from_upload};
use kincal::wire::understood::{Reading, UnderstoodBody};

const FORM: &str = "multipart/form-data; boundary=b";

fn form(program: &str) -> Vec<u8> {
    let positions = "name,x_mm,y_mm,z_mm\nA,1,2,3\nB,4,5,6\n";
    let part = |name: &str, text: &str| {
        format!("--b\r\nContent-Disposition: form-data; name=\"{name}\"\r\n\r\n{text}\r\n")
    };
    let parts = [part("robot", program), part("instrument", positions)].concat();
    format!("{parts}--b--\r\n").into_bytes()
}

#[test]
fn points_without_joint_values_are_listed_and_the_others_are_read() {
    let external = "[9E9,9E9,9E9,9E9,9E9,9E9]";
    // The angles have three decimals, which a table might have as separators of thousands.
    let program = format!(
        "MODULE m\nPERS jointtarget A:=[\n[1.125,2.125,3.125,1.125,2.125,3.125],{external}];\n! CONST jointtarget B:=[[9,9,9,9,9,9],{external}];\n\
         CONST robtarget C:=[[1,2,3],[1,0,0,0],[0,0,0,0],{external}]; CONST jointtarget B:=[[4,5,6,4,5,6],{external}];\nENDMODULE\n"
    );
    let body = form(&program);
    let columns = ColumnsBody::default();
    let upload = Upload {
        content_type: FORM,
        bytes: &body,
        columns: &columns,
        decimal: None,
        rotation: None,
        frame: Frame::Base,
        instrument: None,
    };
    let (set, reading) = from_file(&upload, 6).unwrap();
    let first: Vec<f64> = set.points.iter().map(|p| p.q_rad[0].to_degrees()).collect();
    assert!((first[0] - 1.125).abs() < 1e-9 && (first[1] - 4.0).abs() < 1e-9);
    let json = serde_json::to_string(&reading).unwrap();
    let again = from_upload(FORM, Some(&json), &body, Frame::Base, 6).unwrap();
    assert!(again == set);
    let robot = reading.unwrap().joined.unwrap().robot;
    let unread = robot.unread.unwrap();
    assert_eq!((unread.n, unread.points[0].line), (1, 5));
    assert_eq!(unread.points[0].name, "C");
    assert!(unread.points[0].reason.contains("Cartesian"));
    assert_eq!(robot.skipped_rows, 4);
}

#[test]
fn a_program_of_cartesian_points_is_refused_with_their_lines() {
    let body = form("DEFDAT CAL\nDECL E6POS XP1={X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0}\nENDDAT\n");
    let upload = Upload {
        content_type: FORM,
        bytes: &body,
        columns: &ColumnsBody::default(),
        decimal: None,
        rotation: None,
        frame: Frame::Base,
        instrument: None,
    };
    let error = from_file(&upload, 6).unwrap_err();
    let issue = &error.issues[0];
    assert_eq!(issue.code, "not_angles");
    assert!(issue.detail.contains("P1 (line 2)"), "{}", issue.detail);
    assert!(issue.detail.contains("E6AXIS"), "{}", issue.detail);
}

#[test]
fn what_older_versions_stored_about_a_file_is_still_read() {
    let stored = r#"{"understood":{"separator":"tab","decimal":"point","encoding":"robot program","header_row":1,"columns":[],"ignored":[],"skipped_rows":4}}"#;
    let reading: Reading = serde_json::from_str(stored).unwrap();
    let understood: UnderstoodBody = reading.understood.clone().unwrap();
    assert!(understood.unread.is_none());
    assert_eq!(serde_json::to_string(&reading).unwrap(), stored);
}
