//! Several sessions as one job, the references of instruments, and what a file leaves open: asked with what can be chosen.

use crate::browser::{Browser, Driver, Picture};
use crate::plant::Plant;
use crate::{in_browser, in_place, sign_in};
use serde_json::{Value, json};

#[test]
fn two_sessions_are_fitted_as_one_job_and_the_page_says_what_each_was() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 21", "ER20-0141");
    plant.set(&robot, "first_noisy.csv", "monday");
    plant.set(&robot, "followup_unchanged.csv", "tuesday");
    let key = plant.key(&["read", "upload", "identify"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.go(&format!("/#/robots/{robot}")).await;
        browser
            .until_it_says("Use a set that is here already")
            .await;
        browser
            .run("for (const part of document.querySelectorAll('#calibrate details')) part.open = true")
            .await;
        browser
            .run("[...document.querySelectorAll('#calibrate label')].find((l) => l.innerText.startsWith('monday')).querySelector('input').click()")
            .await;
        browser
            .button("Start calibration")
            .await
            .click()
            .await
            .unwrap();
        browser
            .until_it_says("Sessions that were fitted together")
            .await;
        let said = browser.text().await;
        for text in [
            "from 2 sessions, 200 points together",
            "measured in the same sessions",
            "1. monday",
            "2. tuesday",
            "row 0 of session 1",
        ] {
            assert!(said.contains(text), "{text} is missing: {said}");
        }
        assert_eq!(browser.accessibility().await, Vec::<String>::new());
        browser.picture("sessions", Picture::Whole).await;
        let (_, jobs) = in_place(|| plant.server.get(&format!("/v1/robots/{robot}/jobs")));
        let sets = jobs["items"][0]["request"]["measurement_set_ids"].as_array();
        assert_eq!(sets.map(Vec::len), Some(2), "{jobs}");
        browser.assert_quiet(&[]).await;
    });
}

#[test]
fn a_reference_is_stored_and_an_upload_chooses_it_by_its_name() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 22", "ER20-0142");
    let key = plant.key(&["read", "upload"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser
            .go(&format!("/#/robots/{robot}/correct?cell=open"))
            .await;
        browser.until_it_says("references (0) of the cell").await;
        browser
            .run("document.querySelector('#reference-name').value = 'bar A'; document.querySelector('#reference-instrument').value = 'tracker 7';
                 document.querySelectorAll('.length input').forEach((input, i) => { input.value = ['bar', 1000, 1000.02, 0.004][i]; })")
            .await;
        browser
            .button("Store a reference")
            .await
            .click()
            .await
            .unwrap();
        browser.until_it_says("references (1) of the cell").await;
        let said = browser.text().await;
        assert!(
            said.contains("20.0 ± 4.0") && said.contains("tracker 7"),
            "{said}"
        );
        assert_eq!(browser.accessibility().await, Vec::<String>::new());
        let path = format!("/v1/robots/{robot}/references");
        let (_, stored) = in_place(|| plant.server.get(&path));
        assert_eq!(
            stored["items"][0]["items"][0]["measured_mm"],
            json!(1000.02)
        );
        browser.go(&format!("/#/robots/{robot}")).await;
        browser
            .until("document.querySelector('#instrument-reference option[value=\"bar A\"]')")
            .await;
        browser.assert_quiet(&[]).await;
    });
}

#[test]
fn a_sheet_a_decimal_mark_and_a_convention_are_chosen_where_the_file_leaves_them_open() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 23", "ER20-0143");
    let text = std::fs::read_to_string(crate::plant::data("first_noisy.csv")).unwrap();
    let rows = |text: &str| -> Vec<Vec<String>> {
        let cells = |line: &str| line.split(',').map(str::to_owned).collect();
        text.lines().map(cells).collect()
    };
    let (notes, points) = (rows("day,who"), rows(&text));
    let book = crate::workbooks::xlsx(&[("Notes", &notes), ("Points", &points)]);
    let key = plant.key(&["read", "upload"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.go(&format!("/#/robots/{robot}")).await;
        browser.until("document.querySelector('#set-file')").await;
        let conventions = browser
            .run("return [...document.querySelectorAll('#stated-rotation option')].map((o) => o.value)")
            .await;
        let conventions = conventions.as_array().unwrap();
        assert_eq!(conventions.len(), 26, "25 conventions and none");
        for name in ["intrinsic_xyz", "extrinsic_zyx", "rotation_vector"] {
            assert!(conventions.contains(&Value::from(name)), "{name}");
        }
        browser
            .run(&format!(
                "const dropped = new DataTransfer(); dropped.items.add(new File([new Uint8Array({})], 'two.xlsx'));
                 document.querySelector('.drop').dispatchEvent(new DragEvent('drop', {{ dataTransfer: dropped, bubbles: true, cancelable: true }}))",
                json!(book)
            ))
            .await;
        browser.until_it_says("Which sheet has").await;
        assert_eq!(browser.accessibility().await, Vec::<String>::new());
        browser.button("Points").await.click().await.unwrap();
        browser.until_it_says("100 points in 100").await;
        let open = "q1_deg;q2_deg;q3_deg;q4_deg;q5_deg;q6_deg;x_mm;y_mm;z_mm\n10;-30;20;15;40;5;1,234;1,234;1,345\n20;-30;20;15;40;5;1,334;1,234;1,345\n";
        browser.drop_file(".drop", "open.csv", open).await;
        browser.until_it_says("Which decimal mark has").await;
        browser.button("A comma: 12,5").await;
        browser.assert_quiet(&[422]).await;
    });
}
