//! What a file leaves open is asked, and what several causes explain is told as such: conventions, tips, sheets, mirrored tables, the pendant.

use crate::browser::{Browser, Driver, Picture};
use crate::plant::{Plant, data, job_hash, job_page};
use crate::{in_browser, in_place, sign_in};
use kincal::kinematics::{Robot, t_base_flange};
use kincal::wire::robot::RobotBody;
use nalgebra::{IsometryMatrix3, Point3, Rotation3, Translation3, Vector3};
use serde_json::{Value, json};

/// Chooses a file as a user does.
async fn choose(browser: &Browser, css: &str, name: &str, content: &str) {
    let content = json!(content);
    let script = format!(
        "const given = new DataTransfer(); given.items.add(new File([{content}], '{name}'));
         const input = document.querySelector('{css}'); input.files = given.files; input.dispatchEvent(new Event('change'))"
    );
    browser.run(&script).await;
}

/// Chooses a value of a list.
async fn select(browser: &Browser, css: &str, value: &str) {
    let script = format!(
        "const select = document.querySelector('{css}'); select.value = '{value}'; select.dispatchEvent(new Event('change'))"
    );
    browser.run(&script).await;
}

/// Types into the field with this name.
async fn fill(browser: &Browser, label: &str, value: f64) {
    let script = format!(
        "const input = document.querySelector('#posture [aria-label=\"{label}\"]'); input.value = '{value}'; input.dispatchEvent(new Event('input'))"
    );
    browser.run(&script).await;
}

async fn offers_to_add(browser: &Browser) -> bool {
    browser
        .run("return [...document.querySelectorAll('button')].some((b) => b.innerText === 'Add robot')")
        .await
        == true
}

#[test]
fn no_convention_of_a_table_of_links_is_assumed() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let key = plant.key(&["read", "upload"]);
    let table = "a_mm,alpha_deg,d_mm,theta_offset_deg\n0,90,400,0\n300,0,0,0\n20,90,0,90\n0,-90,320,0\n0,90,0,0\n0,0,90,0\n";
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("There is no robot yet").await;
        for name in ["arm.csv", "another.csv"] {
            choose(browser, "#robot-file", name, table).await;
            browser
                .until_it_says("Choose the convention of the table: standard or modified.")
                .await;
            assert!(!offers_to_add(browser).await, "{name}");
            browser
                .until("document.activeElement.id === 'robot-convention'")
                .await;
            select(browser, "#robot-convention", "dh").await;
            browser.until_it_says("Read with 6 joints").await;
            assert!(offers_to_add(browser).await, "{name}");
        }
        assert_eq!(browser.accessibility().await, Vec::<String>::new());
        browser.assert_quiet(&[]).await;
    });
}

#[test]
fn the_end_of_an_arm_with_several_tips_is_chosen_and_what_was_read_is_said() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let key = plant.key(&["read", "upload"]);
    let joint = |name: &str, kind: &str, parent: &str, child: &str, at: &str| {
        format!(
            "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/><origin xyz=\"{at}\"/><axis xyz=\"0 0 1\"/><limit lower=\"-3\" upper=\"3\" effort=\"1\" velocity=\"1\"/></joint>"
        )
    };
    let links: String = ["base", "l1", "l2", "tool0", "camera"]
        .iter()
        .map(|name| format!("<link name=\"{name}\"/>"))
        .collect();
    let urdf = format!(
        "<robot name=\"two\">{links}{}{}{}{}</robot>",
        joint("j1", "revolute", "base", "l1", "0 0 0.4"),
        joint("j2", "revolute", "l1", "l2", "0.3 0 0"),
        joint("jt", "fixed", "l2", "tool0", "0.2 0 0"),
        joint("jc", "fixed", "l2", "camera", "0 0.1 0.1")
    );
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("There is no robot yet").await;
        choose(browser, "#robot-file", "two.urdf", &urdf).await;
        browser.until_it_says("Name the tip link").await;
        let named = "return [...document.querySelectorAll('#robot-tip optgroup:first-of-type option')].map((o) => o.value).sort()";
        assert_eq!(browser.run(named).await, json!(["camera", "tool0"]));
        select(browser, "#robot-tip", "tool0").await;
        browser
            .until_it_says("Read with 2 joints, from base to tool0.")
            .await;
        browser
            .until_it_says("Fixed frames that are part of the arm: tool0.")
            .await;
        browser.until_it_says("Not part of the arm: camera.").await;
        browser.assert_quiet(&[422]).await;
    });
}

/// A session of a library arm as a tracker sees it, whose first and third column were exchanged.
fn mirrored(body: &RobotBody) -> String {
    let robot = Robot::try_from(body).unwrap();
    let place = IsometryMatrix3::from_parts(
        Translation3::new(2300.0, -450.0, 800.0),
        Rotation3::from_euler_angles(0.01, -0.02, 2.1),
    );
    let mut text = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,z_mm,y_mm,x_mm\n".to_owned();
    for i in 0..40_u32 {
        let q_deg: Vec<f64> = (0..6)
            .map(|k| {
                let (low, high) = [
                    (-120.0, 120.0),
                    (-130.0, -20.0),
                    (10.0, 120.0),
                    (-120.0, 120.0),
                    (-90.0, 90.0),
                    (-170.0, 170.0),
                ][k as usize];
                let share = f64::from((i * 7919 + k * 104_729 + i * i * (31 + k)) % 1009) / 1009.0;
                low + share * (high - low)
            })
            .collect();
        let q_rad: Vec<f64> = q_deg.iter().map(|q| q.to_radians()).collect();
        let flange = t_base_flange(&robot.links, &robot.q_model_rad(&q_rad));
        let p = (place * flange) * Point3::from(Vector3::new(60.0, 15.0, 90.0));
        let q: Vec<String> = q_deg.iter().map(|q| format!("{q:.4}")).collect();
        text += &format!("{},{:.4},{:.4},{:.4}\n", q.join(","), p.x, p.y, p.z);
    }
    text
}

#[test]
fn a_mirrored_table_is_no_reason_to_change_the_joint_map_of_a_library_arm() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let (_, model) = plant.server.get("/v1/robot-models/kuka_kr10_r1100_2");
    let body: RobotBody = serde_json::from_value(model["robot"].clone()).unwrap();
    let robot = plant.server.create(
        "/v1/robots",
        "application/json",
        model["robot"].to_string().into_bytes(),
    );
    let key = plant.key(&["read", "upload"]);
    let table = mirrored(&body);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("not calibrated").await;
        browser.go(&format!("/#/robots/{robot}")).await;
        browser.until("document.querySelector('#set-file')").await;
        browser
            .run("document.querySelector('input[value=instrument]').click()")
            .await;
        browser.drop_file(".drop", "mirrored.csv", &table).await;
        browser
            .until_it_says("The points fit in more than one way.")
            .await;
        browser
            .until_it_says("Two columns of the table are exchanged, or its frame is left-handed.")
            .await;
        browser
            .until_it_says("The joint map of this robot comes from the library")
            .await;
        let button = "[...document.querySelectorAll('button')].find((b) => b.textContent.startsWith('Store this joint map'))";
        let state = format!("return [{button}.checkVisibility(), {button}.disabled]");
        assert_eq!(
            browser.run(&state).await,
            json!([false, true]),
            "no single click stores a joint map"
        );
        browser
            .run(&format!("{button}.closest('details').open = true"))
            .await;
        assert_eq!(browser.accessibility().await, Vec::<String>::new());
        browser
            .picture("mirrored", Picture::Element("#calibrate"))
            .await;
        browser.assert_quiet(&[422]).await;
    });
    let (_, stored) = plant.server.get(&format!("/v1/robots/{robot}"));
    assert_eq!(stored["joint_map"], model["robot"]["joint_map"]);
}

#[test]
fn two_sheets_of_one_workbook_are_the_robots_and_the_instruments_file() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 26", "ER20-0146");
    let text = std::fs::read_to_string(data("first_noisy.csv")).unwrap();
    let part = |from: usize, to: usize| -> Vec<Vec<String>> {
        let row = |(i, line): (usize, &str)| {
            let name = if i == 0 {
                "name".to_owned()
            } else {
                format!("P{i}")
            };
            let cells = line.split(',').skip(from).take(to - from);
            std::iter::once(name)
                .chain(cells.map(str::to_owned))
                .collect()
        };
        text.lines().enumerate().map(row).collect()
    };
    let (joints, positions) = (part(2, 8), part(8, 11));
    let book = crate::workbooks::xlsx(&[("Robot", &joints), ("Tracker", &positions)]);
    let key = plant.key(&["read", "upload"]);
    let drop = |names: &str| {
        format!(
            "const dropped = new DataTransfer(); for (const name of {names}) dropped.items.add(new File([new Uint8Array({})], name));
             document.querySelector('.drop').dispatchEvent(new DragEvent('drop', {{ dataTransfer: dropped, bubbles: true, cancelable: true }}))",
            json!(book)
        )
    };
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.go(&format!("/#/robots/{robot}")).await;
        browser.until("document.querySelector('#set-file')").await;
        browser.run(&drop("['one.xlsx']")).await;
        browser.until_it_says("stand on two sheets").await;
        assert_eq!(browser.accessibility().await, Vec::<String>::new());
        let together = browser.button("Read the two sheets together").await;
        together.click().await.unwrap();
        browser.until_it_says("one: 100 points in 100").await;
        // two copies: each has a sheet of its own
        browser.run(&drop("['a.xlsx', 'b.xlsx']")).await;
        browser.button("a.xlsx").await.click().await.unwrap();
        browser
            .until_it_says("Which sheet has the robot's joint values?")
            .await;
        browser.button("Robot").await.click().await.unwrap();
        browser
            .until_it_says("Which sheet has the instrument's positions?")
            .await;
        browser.button("Tracker").await.click().await.unwrap();
        browser.until_it_says("a: 100 points in 100").await;
        browser.assert_quiet(&[422]).await;
    });
}

#[test]
fn a_posture_is_compared_with_the_pendant_and_says_what_it_does_not_show() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let mut body: Value =
        serde_json::from_slice(&std::fs::read(data("robot.json")).unwrap()).unwrap();
    body["links"][0]["joint_limits_deg"] = json!([-170, 170]);
    let bytes = body.to_string().into_bytes();
    let robot = plant.server.create("/v1/robots", "application/json", bytes);
    let q_deg = [12.0, -31.0, 22.0, 15.0, 41.0, 77.0];
    let body = json!({"q_deg": q_deg}).to_string().into_bytes();
    let path = format!("/v1/robots/{robot}/posture");
    let (_, shown) = plant.server.post(&path, "application/json", body);
    let number = |of: &Value, i: usize| of[i].as_f64().unwrap();
    let key = plant.key(&["read"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.go(&format!("/#/robots/{robot}")).await;
        browser.until("document.querySelector('#posture')").await;
        browser
            .run("document.querySelector('#posture').open = true")
            .await;
        browser
            .until("document.querySelector('#posture input')")
            .await;
        for (i, q) in q_deg.iter().enumerate() {
            fill(browser, &format!("Joint {}, degrees", i + 1), *q).await;
        }
        for (i, axis) in ["x", "y", "z"].iter().enumerate() {
            let value = number(&shown["position_mm"], i);
            fill(browser, &format!("{axis} on the pendant, mm"), value).await;
        }
        browser
            .until_it_says("Pendant and arm are 0.00 mm apart.")
            .await;
        browser.until_it_says("Joint 6 was not compared").await;
        select(browser, "#posture fieldset select", "abc").await;
        for (i, angle) in ["A", "B", "C"].iter().enumerate() {
            let turned = if i == 2 { 0.5 } else { 0.0 };
            let value = number(&shown["kuka_abc_deg"], i) + turned;
            fill(browser, &format!("{angle} on the pendant"), value).await;
        }
        browser
            .until_it_says("Pendant and arm are 0.00 mm and 0.500° apart.")
            .await;
        assert!(!browser.text().await.contains("was not compared"));
        fill(browser, "Joint 1, degrees", 200.0).await;
        browser
            .until_it_says("Joint 1: 200.00° is outside of its limits, −170.00° to 170.00°.")
            .await;
        assert!(!browser.text().await.contains("Pendant and arm"));
        assert_eq!(browser.accessibility().await, Vec::<String>::new());
        browser.assert_quiet(&[]).await;
    });
}

/// The page states no serial number by itself; what was stated stays with the set when points are left out of it.
#[test]
fn a_serial_number_is_stated_by_whoever_read_it_and_stays_with_the_set() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 28", "ER20-0148");
    let path = format!(
        "/v1/robots/{robot}/measurement-sets?frame=base&name=first&serial_number=ER20-0148"
    );
    let bytes = std::fs::read(data("first_noisy.csv")).unwrap();
    let set = plant.server.create(&path, "text/csv", bytes);
    let job = plant.calibrated(&robot, &set, "least_squares");
    let key = plant.key(&["read", "upload", "identify"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.go(&format!("/#/robots/{robot}")).await;
        browser
            .until("document.querySelector('#stated-serial')")
            .await;
        let value = "return document.querySelector('#stated-serial').value";
        assert_eq!(browser.run(value).await, "");
        let page = job_hash(&job);
        browser.go(&job_page(&job)).await;
        browser.select_first_point().await;
        let leave = browser.button("Leave it out …").await;
        leave.click().await.unwrap();
        let field = browser.find("#exclude-reason").await;
        field.send_keys("not seated").await.unwrap();
        let again = browser.button("Calibrate again without them").await;
        again.click().await.unwrap();
        browser.until(&format!("location.hash !== '{page}'")).await;
        browser.until_it_says("What to do next").await;
        // the keyboard follows to the menu of exports
        let export = browser.button("Export …").await;
        export.click().await.unwrap();
        browser
            .until("document.activeElement.id === 'exports'")
            .await;
        browser.until_it_says("of the held-out points").await;
        let path = format!("/v1/robots/{robot}/measurement-sets");
        let (_, sets) = in_place(|| plant.server.get(&path));
        let items = sets["items"].as_array().unwrap();
        assert_eq!(items.len(), 2);
        for set in items {
            assert_eq!(set["serial_number"], "ER20-0148", "{set}");
        }
        browser.assert_quiet(&[]).await;
    });
}
