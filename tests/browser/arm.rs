//! The arm in 3-D, and the figures and the table that share its selection.

use crate::browser::{Browser, DESKTOP, Driver, Look, PHONE, TABLET};
use crate::plant::{Plant, data, job_hash, job_page};
use crate::{in_browser, in_place, sign_in};
use kincal::kinematics::{Robot, forward_kinematics};
use kincal::wire::robot::RobotBody;
use nalgebra::Vector3;
use serde_json::{Value, json};
use thirtyfour::Key;

/// Largest difference of a position computed in the page, mm: rounding of double precision on an arm of some metres.
const SAME_MM: f64 = 1e-9;

/// A robot with everything that the page's kinematics know: betas, and a joint map with signs, offsets and a coupling.
fn mapped_robot() -> Value {
    json!({
        "name": "mapped",
        "links": [
            {"a_mm": 0, "alpha_deg": 0, "d_mm": 504, "theta_offset_deg": 1.5},
            {"a_mm": 166.6, "alpha_deg": -90, "d_mm": 0, "theta_offset_deg": 0},
            {"a_mm": 782.3, "alpha_deg": 0.2, "d_mm": 3, "theta_offset_deg": -90, "beta_deg": 0.7},
            {"a_mm": 138.8, "alpha_deg": -90, "d_mm": 761.4, "theta_offset_deg": 0},
            {"a_mm": 0, "alpha_deg": 90, "d_mm": 0, "theta_offset_deg": 0},
            {"a_mm": 0, "alpha_deg": -90, "d_mm": 125, "theta_offset_deg": 180}
        ],
        "joint_map": {
            "sign": [1, 1, -1, 1, -1, 1],
            "offset_deg": [0, -90, 0, 0, 0, 12.5],
            "coupling": [[1,0,0,0,0,0],[0,1,0,0,0,0],[0,1,1,0,0,0],[0,0,0,1,0,0],[0,0,0,0,1,0],[0,0,0,0,0.01,1]]
        }
    })
}

#[test]
fn the_page_puts_the_arm_where_the_service_does() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let document = mapped_robot();
    let body: RobotBody = serde_json::from_value(document.clone()).unwrap();
    let robot = Robot::try_from(&body).unwrap();
    let poses: Vec<Vec<f64>> = (0..20)
        .map(|i| {
            (0..6)
                .map(|k| f64::from((37 * i + 61 * k) % 300) - 150.0 + 0.37 * f64::from(k))
                .collect()
        })
        .collect();
    let target = [12.0, -34.0, 56.0];
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        browser.go("/").await;
        let script = format!(
            "return import('/assets/kinematics.js').then(({{ positionOf }}) => {}.map((q) => positionOf({document}, q, {})))",
            json!(poses),
            json!(target)
        );
        let found = browser.run(&script).await;
        for (q_deg, found) in poses.iter().zip(found.as_array().unwrap()) {
            let q_rad: Vec<f64> = q_deg.iter().map(|q| q.to_radians()).collect();
            let expected = forward_kinematics(
                &robot.links,
                &robot.q_model_rad(&q_rad),
                &Vector3::from(target),
            );
            for (k, expected) in expected.iter().enumerate() {
                let found = found[k].as_f64().unwrap();
                assert!(
                    (found - expected).abs() < SAME_MM,
                    "{q_deg:?}, axis {k}: {found} and {expected}"
                );
            }
        }
    });
}

/// The selected row as the panel beside the arm, the table and the figure state it. In the table a button stands behind the row.
async fn selected(browser: &Browser) -> [String; 3] {
    let script = "return [document.querySelector('.picked .which')?.innerText ?? '', document.querySelector('.residuals tr.chosen td')?.firstChild.textContent ?? '', \
        document.querySelector('.answers .value strong')?.innerText ?? '']";
    let found = browser.run(script).await;
    [0, 1, 2].map(|i| found[i].as_str().unwrap().to_owned())
}

#[test]
fn a_point_that_is_picked_in_one_figure_is_picked_in_all() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 11", "ER20-0131");
    let job = plant.identified(&robot, "first_noisy.csv");
    let key = plant.key(&["read", "upload", "identify"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("result to review").await;
        browser
            .run(&format!(
                "location.hash = '#/jobs/{}'",
                job["id"].as_str().unwrap()
            ))
            .await;
        browser
            .until("document.querySelector('canvas.scene')")
            .await;
        browser
            .until("document.querySelectorAll('#error-against option').length > 6")
            .await;

        // By keyboard, from the arm.
        browser
            .run("document.querySelector('canvas.scene').focus()")
            .await;
        browser.press("nnn").await;
        browser
            .until("document.querySelector('.picked .which')?.innerText.startsWith('Row 2 ')")
            .await;
        let [panel, row, bar] = selected(browser).await;
        assert!(panel.starts_with("Row 2 "), "{panel}");
        assert_eq!([row.as_str(), bar.as_str()], ["row 2", "row 2"]);
        assert!(
            browser.text().await.contains("Joints, °"),
            "the arm stands in the row's posture"
        );

        // By pointer: somewhere around the middle of the picture there is a point.
        browser.press(Key::Escape).await;
        browser
            .until("!document.querySelector('.picked .which')")
            .await;
        let mut hit = false;
        for (x, y) in (-4..=4).flat_map(|x| (-4..=4).map(move |y| (30 * x, 30 * y))) {
            browser.click_at("canvas.scene", x, y).await;
            hit = browser
                .run("return Boolean(document.querySelector('.picked .which'))")
                .await
                == true;
            if hit {
                break;
            }
        }
        assert!(hit, "a click picks a point");
        let [panel, row, bar] = selected(browser).await;
        assert!(
            panel.starts_with(&row.replace("row", "Row")) && row == bar,
            "{panel}, {row}, {bar}"
        );

        // From the table, and from the bars.
        let listed = browser
            .run("const tr = document.querySelectorAll('.residuals tbody tr:not(.chosen)')[3]; tr.click(); return tr.querySelector('td').innerText")
            .await;
        let listed = listed.as_str().unwrap().replace("row", "Row");
        browser
            .until(&format!(
                "document.querySelector('.picked .which')?.innerText.startsWith('{listed} ')"
            ))
            .await;
        browser
            .run("document.querySelector('.answers svg[tabindex]').focus()")
            .await;
        browser.press(Key::Right).await;
        browser
            .until(&format!(
                "!document.querySelector('.picked .which').innerText.startsWith('{listed} ')"
            ))
            .await;
        let [panel, row, bar] = selected(browser).await;
        assert!(
            panel.starts_with(&row.replace("row", "Row")) && row == bar,
            "{panel}, {row}, {bar}"
        );

        // Against a joint, and to the scale of "after".
        browser
            .run("const s = document.querySelector('#error-against'); s.value = 'q1'; s.dispatchEvent(new Event('change'))")
            .await;
        browser.until_it_says("joint 2, °").await;
        let circles = "return document.querySelectorAll('.answers circle.after').length";
        assert_eq!(browser.run(circles).await, 100);
        browser
            .button("Scale to after")
            .await
            .click()
            .await
            .unwrap();
        browser
            .until("document.querySelector('.answers [aria-pressed=true]')")
            .await;
        browser.assert_quiet(&[]).await;
    });
}

/// Fills in why a point is left out, and calibrates again.
async fn calibrate_without_it(browser: &Browser, reason: &str) {
    let field = browser.find("#exclude-reason").await;
    field.send_keys(reason).await.unwrap();
    let button = browser.button("Calibrate again without them").await;
    button.click().await.unwrap();
}

#[test]
fn a_point_is_left_out_with_its_reason_and_the_rest_is_calibrated_again() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 12", "ER20-0132");
    let job = plant.identified(&robot, "first_noisy.csv");
    let key = plant.key(&["read", "upload", "identify"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("result to review").await;
        let page = job_hash(&job);
        browser.run(&format!("location.hash = '{page}'")).await;
        browser.select_first_point().await;
        browser
            .button("Leave it out …")
            .await
            .click()
            .await
            .unwrap();
        browser
            .until_it_says("One point is to be left out: row 0")
            .await;
        calibrate_without_it(browser, "the reflector was not seated").await;
        browser.until(&format!("location.hash !== '{page}'")).await;
        browser
            .until_it_says("first without line 2: the reflector was not seated (99 points")
            .await;
        browser.until_it_says("What to do next").await;
        browser.assert_quiet(&[]).await;
    });
}

/// The paper's first set as two files in a form, with one position that is 4 mm off; the instrument writes decimal commas.
fn two_files_with_a_stray() -> Vec<u8> {
    let text = std::fs::read_to_string(data("first_noisy.csv")).unwrap();
    let mut robot = "Point;A1 [deg];A2 [deg];A3 [deg];A4 [deg];A5 [deg];A6 [deg]\r\n".to_owned();
    let mut instrument = "Name;X (mm);Y (mm);Z (mm)\r\n".to_owned();
    for (row, line) in text.lines().skip(1).enumerate() {
        let mut numbers: Vec<f64> = line
            .split(',')
            .skip(2)
            .map(|cell| cell.parse().unwrap())
            .collect();
        numbers[7] += if row == 17 { 4.0 } else { 0.0 };
        let cells: Vec<String> = numbers
            .iter()
            .map(|number| format!("{number:.6}").replace('.', ","))
            .collect();
        robot += &format!("P{row};{}\r\n", cells[..6].join(";"));
        instrument += &format!("P{row};{}\r\n", cells[6..].join(";"));
    }
    let part = |name: &str, text: &str| {
        format!("--b\r\nContent-Disposition: form-data; name=\"{name}\"\r\n\r\n{text}\r\n")
    };
    format!(
        "{}{}--b--\r\n",
        part("robot", &robot),
        part("instrument", &instrument)
    )
    .into_bytes()
}

#[test]
fn after_another_session_the_release_is_next_and_a_stray_row_of_two_files_can_be_left_out() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 24", "ER20-0144");
    let path = format!("/v1/robots/{robot}/measurement-sets?frame=base&name=logs");
    let form = "multipart/form-data; boundary=b";
    let set = plant.server.create(&path, form, two_files_with_a_stray());
    let first = plant.calibrated(&robot, &set, "least_squares");
    let second = plant.set(&robot, "followup_unchanged.csv", "second");
    let key = plant.key(&["read", "upload", "identify", "release"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        let page = job_page(&first);
        browser.go(&page).await;
        browser.until_it_says("Look at row 17").await;
        let request = json!({"kind": "verify", "measurement_set_id": second, "parameter_set_id": first["parameter_set_id"]});
        in_place(|| plant.server.finished(&plant.server.job(&robot, &request)));
        browser.go("/#/").await;
        browser.until_it_says("result to review").await;
        browser.go(&page).await;
        browser.until_it_says("It can be released below.").await;
        browser.button("Look at it").await.click().await.unwrap();
        browser
            .button("Leave it out …")
            .await
            .click()
            .await
            .unwrap();
        calibrate_without_it(browser, "it slipped").await;
        browser
            .until_it_says(
                "logs without P17, line 19 (1 of 50 verify points): it slipped (99 points",
            )
            .await;
        browser.until_it_says("What to do next").await;
        browser.assert_quiet(&[]).await;
    });
}

/// What is pressed outside of a sentence and is less than 24 px high.
const SMALL: &str = "return [...document.querySelectorAll('main a, main button, main input, main select, main summary')] \
    .filter((e) => e.checkVisibility() && !e.closest('p, li, .docs') && !['checkbox', 'radio'].includes(e.type)) \
    .filter((e) => e.getBoundingClientRect().height < 23.5).map((e) => e.outerHTML.slice(0, 120))";

#[test]
fn no_page_scrolls_sideways_on_a_desk_a_tablet_or_a_phone() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 13", "ER20-0133");
    let job = plant.identified(&robot, "first_noisy.csv");
    let key = plant.key(&["admin"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("result to review").await;
        let pages = [
            "/#/".to_owned(),
            format!("/#/robots/{robot}"),
            format!("/#/robots/{robot}/plan"),
            format!("/#/robots/{robot}/correct"),
            format!("/#/robots/{robot}/compare"),
            job_page(&job),
            "/docs".into(),
        ];
        for (size, dark) in [(DESKTOP, false), (TABLET, true), (PHONE, false)] {
            browser.look(Look { size, dark }).await;
            for page in &pages {
                browser.go(page).await;
                let wide = browser
                    .run("return document.documentElement.scrollWidth - innerWidth")
                    .await;
                assert!(
                    wide.as_i64().unwrap() <= 0,
                    "{page} at {}: {wide} px too wide",
                    size.0
                );
                let small = browser.run(SMALL).await;
                assert_eq!(small, json!([]), "{page} at {}", size.0);
                assert_eq!(
                    browser.accessibility().await,
                    Vec::<String>::new(),
                    "{page} at {}",
                    size.0
                );
            }
        }
        browser.assert_quiet(&[]).await;
    });
}

#[test]
fn a_long_result_has_links_to_its_parts_and_the_robots_page_shows_the_arm_that_runs() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 45", "ER20-0165");
    let job = plant.identified(&robot, "first_noisy.csv");
    plant.release(&job, "the first one");
    let key = plant.key(&["read", "upload", "identify", "release"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        for size in [DESKTOP, PHONE] {
            browser.look(Look { size, dark: false }).await;
            browser.go(&job_page(&job)).await;
            browser.until("document.querySelector('.contents a')").await;
            let parts = browser
                .run("return [...document.querySelectorAll('.contents a')].map((a) => a.innerText)")
                .await;
            for part in [
                "What to do next",
                "Parameter set",
                "Parameters",
                "Export: take it along",
            ] {
                let parts = parts.as_array().unwrap();
                assert!(parts.iter().any(|one| one == part), "{part}: {parts:?}");
            }
            // by the keyboard
            browser
                .run("[...document.querySelectorAll('.contents a')].find((a) => a.innerText === 'Parameters').focus()")
                .await;
            browser.press(Key::Enter).await;
            browser
                .until("document.activeElement.innerText === 'Parameters' && document.activeElement.matches('h2')")
                .await;
            let seen = browser
                .run("const { top } = document.activeElement.getBoundingClientRect(); return top >= 0 && top < innerHeight / 4")
                .await;
            assert_eq!(seen, json!(true), "its heading is at the top");
            assert!(
                browser
                    .run("return location.hash")
                    .await
                    .as_str()
                    .unwrap()
                    .contains("/jobs/")
            );
        }
        browser
            .look(Look {
                size: DESKTOP,
                dark: false,
            })
            .await;
        browser.go(&format!("/#/robots/{robot}")).await;
        browser
            .until_it_says("by the parameters of the active set")
            .await;
        browser
            .until("document.querySelector('figure.arm canvas.scene')")
            .await;
        browser.assert_quiet(&[]).await;
    });
}
