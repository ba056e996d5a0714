//! The way of somebody who has never calibrated a robot: what the pages say next, and what they ask only once.

use crate::browser::{Browser, Driver};
use crate::plant::{Plant, data, job_page};
use crate::{in_browser, sign_in};
use serde_json::json;

#[test]
fn an_empty_page_leads_to_a_robot_of_the_library_and_to_its_first_poses() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let key = plant.key(&["read", "upload"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("There is no robot yet").await;
        browser
            .run("[...document.querySelectorAll('summary')].find((s) => s.innerText.startsWith('Choose from')).click()")
            .await;
        browser
            .until("document.querySelector('#robot-model-search')")
            .await;
        browser
            .run("const s = document.querySelector('#robot-model-search'); s.value = 'ur10e'; s.dispatchEvent(new Event('input'))")
            .await;
        browser
            .until("document.querySelectorAll('#robot-model option').length === 1")
            .await;
        browser.button("Look at it").await.click().await.unwrap();
        browser
            .until("document.querySelector('#robot-stored-serial')")
            .await;
        browser
            .run("document.querySelector('#robot-stored-serial').value = 'SN-77'")
            .await;
        browser.button("Add robot").await.click().await.unwrap();
        browser.until_it_says("serial number SN-77").await;
        browser.until_it_says("What to do next").await;
        assert_eq!(browser.accessibility().await, Vec::<String>::new());
        browser.assert_quiet(&[]).await;
    });
}

#[test]
fn a_verification_says_what_to_do_next_and_so_does_the_set_afterwards() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 15", "ER20-0135");
    let first = plant.identified(&robot, "first_noisy.csv");
    let second = plant.set(&robot, "followup_unchanged.csv", "second");
    let request = json!({"kind": "verify", "measurement_set_id": second, "parameter_set_id": first["parameter_set_id"]});
    let verification = plant.server.finished(&plant.server.job(&robot, &request));
    let key = plant.key(&["read", "upload", "identify", "release"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("result to review").await;
        browser.go(&job_page(&verification)).await;
        browser
            .until_it_says(
                "The set holds on this session. Its page says whether a release would be accepted.",
            )
            .await;
        browser.go(&job_page(&first)).await;
        browser
            .until_it_says("The fit holds on another session. It can be released below.")
            .await;
        // The way to the release ends at its button.
        browser
            .button("To the release")
            .await
            .click()
            .await
            .unwrap();
        browser
            .until("document.activeElement.innerText === 'Release …'")
            .await;
        // The robot's page says the same evidence.
        browser.go(&format!("/#/robots/{robot}")).await;
        browser.until_it_says("a later session verified it").await;
        browser.assert_quiet(&[]).await;
    });
}

#[test]
fn what_columns_mean_is_asked_once() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 16", "ER20-0136");
    let text = std::fs::read_to_string(data("first_noisy.csv")).unwrap();
    let (header, rows) = text.split_once('\n').unwrap();
    let renamed = header
        .replace("_deg", "")
        .replace('q', "J")
        .replace("_mm", "");
    assert_ne!(renamed, header);
    let odd = format!("{renamed}\n{rows}");
    let key = plant.key(&["read", "upload", "identify"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("not calibrated").await;
        browser.go(&format!("/#/robots/{robot}")).await;
        browser
            .until_it_says("This robot has not been calibrated yet")
            .await;
        browser.drop_file(".drop", "odd.csv", &odd).await;
        browser.until_it_says("Say once what the columns are").await;
        let said = browser.text().await;
        assert!(
            !said.contains("?columns") && !said.contains("--columns"),
            "words for programs: {said}"
        );
        // Without a unit nothing is read. One joint and one axis are chosen, and the others follow.
        browser.button("Read it so").await.click().await.unwrap();
        browser.until_it_says("choose its unit").await;
        browser
            .run(
                "for (const [column, means] of [['J1', 'q1_deg'], ['x', 'x_mm']]) {
                     const select = document.querySelector(`.columns select[aria-label$=', ${column}']`);
                     select.value = means;
                     select.dispatchEvent(new Event('change'));
                 }",
            )
            .await;
        browser.button("Read it so").await.click().await.unwrap();
        browser.until_it_says("odd: 100 points").await;
        // The postures of such a file are shown, too.
        browser.until_it_says("Are these your poses?").await;
        browser.drop_file(".drop", "again.csv", &odd).await;
        browser.until_it_says("again: 100 points").await;
        browser.assert_quiet(&[422]).await;
    });
}

#[test]
fn archived_robots_are_found_and_jobs_are_counted_by_the_service() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 17", "ER20-0137");
    let scrapped = plant.robot("Cell 18, scrapped", "ER20-0138");
    plant.identified(&robot, "first_noisy.csv");
    let reason = json!({"reason": "scrapped"}).to_string().into_bytes();
    let path = format!("/v1/robots/{scrapped}/archive");
    let (status, answer) = plant.server.post(&path, "application/json", reason);
    assert_eq!(status, 200, "{answer}");
    let key = plant.key(&["read"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("result to review").await;
        assert!(!browser.text().await.contains("scrapped"));
        browser
            .run("[...document.querySelectorAll('.chip')].find((b) => b.innerText.startsWith('Archived')).click()")
            .await;
        browser.until_it_says("Cell 18, scrapped").await;
        browser.go(&format!("/#/robots/{scrapped}")).await;
        browser.until_it_says("This robot was archived").await;
        browser.go("/#/jobs").await;
        browser.until_it_says("1 of 1 jobs").await;
        browser
            .run("const s = document.querySelector('#job-status'); s.value = 'failed'; s.dispatchEvent(new Event('change'))")
            .await;
        browser.until_it_says("No such job.").await;
        browser.assert_quiet(&[]).await;
    });
}

/// The table of a plan, as it is downloaded.
async fn downloaded_plan(browser: &Browser, plant: &Plant) -> String {
    let folder = plant.folder.path().join("downloads");
    browser.download_to(&folder).await;
    browser
        .button("Download as CSV")
        .await
        .click()
        .await
        .unwrap();
    let file = folder.join("poses.csv");
    browser.until_there_is(&file).await;
    std::fs::read_to_string(&file).unwrap()
}

#[test]
fn a_plan_within_typed_joint_limits_is_downloaded_with_a_row_for_each_pose() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 19", "ER20-0139");
    let key = plant.key(&["admin"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("not calibrated").await;
        browser.go(&format!("/#/robots/{robot}")).await;
        browser
            .until_it_says("Name, mounting, joint limits, policy")
            .await;
        browser
            .run("[...document.querySelectorAll('summary')].find((s) => s.innerText.startsWith('Name, mounting, joint limits')).click()")
            .await;
        browser
            .until("document.querySelector(\"[aria-label='Joint 1, upper limit, °']\")")
            .await;
        // A number field would drop the comma, and 0,02 would be 2.
        let tolerance = browser.find("#policy-tolerance").await;
        tolerance.send_keys("0,02").await.unwrap();
        let typed = tolerance.prop("value").await.unwrap();
        assert_eq!(typed.as_deref(), Some("0.02"));
        let one_limit = "document.querySelectorAll(\"[aria-label^='Joint 1,']\").forEach((input, i) => { input.value = ['', 40][i]; })";
        browser.run(one_limit).await;
        let store = "[...document.querySelectorAll('form')].find((f) => f.innerText.includes('Joint limits')).requestSubmit()";
        browser.run(store).await;
        browser.until_it_says("Joint 1 has one limit").await;
        browser
            .run(&one_limit.replace("['', 40]", "[-20, 40]"))
            .await;
        browser.run(store).await;
        // the page is drawn anew, with the form closed
        browser
            .until("!document.querySelector(\"[aria-label='Joint 1, upper limit, °']\")")
            .await;
        browser.go(&format!("/#/robots/{robot}/plan")).await;
        browser.button("Plan").await.click().await.unwrap();
        browser.until_it_says("Joint values").await;
        // The last poses repeat the first ones, and say so.
        browser.until_it_says("pose 3").await;
        let table = downloaded_plan(browser, &plant).await;
        assert_eq!(
            table.lines().count(),
            1 + 30,
            "a header and a row for each pose"
        );
        for line in table.lines().skip(1) {
            let q1_deg: f64 = line.split(',').nth(1).unwrap().parse().unwrap();
            assert!((-20.0..=40.0).contains(&q1_deg), "{line}");
        }
        browser.assert_quiet(&[]).await;
    });
}

/// The boxes used to be sent as those in which the reflector has to be.
#[test]
fn a_plan_keeps_out_of_the_boxes_that_were_typed() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 20", "ER20-0140");
    let key = plant.key(&["admin"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("not calibrated").await;
        browser.go(&format!("/#/robots/{robot}/plan")).await;
        browser.button("Add a box").await.click().await.unwrap();
        browser.button("Add a place").await.click().await.unwrap();
        browser.button("Add a place").await.click().await.unwrap();
        browser
            .run(
                "const type = (label, values) => document.querySelectorAll(`[aria-label='${label}']`).forEach((input, i) => { input.value = values[i]; });
                 type('x from, mm', [600]); type('y from, mm', [-3000]); type('z from, mm', [-3000]); type('x to, mm', [3000]); type('y to, mm', [3000]); type('z to, mm', [3000]);
                 type('x, mm', [-3000, -3000]); type('y, mm', [-2000, 2000]); type('z, mm', [1000, 1000]);
                 document.querySelector('#plan-kind').value = 'pose';",
            )
            .await;
        browser.button("Plan").await.click().await.unwrap();
        browser.until_it_says("Joint values").await;
        browser.until_it_says("place 2").await;
        let table = downloaded_plan(browser, &plant).await;
        let mut lines = table.lines();
        let header = lines.next().unwrap();
        assert_eq!(
            header,
            "configuration,station,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm,quat_w,quat_x,quat_y,quat_z"
        );
        let robot: kincal::wire::robot::RobotBody =
            serde_json::from_slice(&std::fs::read(data("robot.json")).unwrap()).unwrap();
        let robot = kincal::kinematics::Robot::try_from(&robot).unwrap();
        let mut n = 0;
        for line in lines {
            let cells: Vec<&str> = line.split(',').collect();
            let q: Vec<f64> = cells[2..8]
                .iter()
                .map(|q| q.parse::<f64>().unwrap().to_radians())
                .collect();
            let flange = kincal::kinematics::t_base_flange(&robot.links, &robot.q_model_rad(&q));
            assert!(flange.translation.vector.x < 600.0, "{line}");
            n += 1;
        }
        assert_eq!(n, 30);
        browser.assert_quiet(&[]).await;
    });
}
