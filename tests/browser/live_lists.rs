//! The list of robots and the pages of a robot and its jobs say the same, and follow what runs.

use crate::browser::{Browser, DESKTOP, Driver, Look, PHONE};
use crate::plant::{Plant, data, job_page};
use crate::{in_browser, in_place, sign_in};
use serde_json::json;

/// The paper's first set as a robot measures it whose third joint has lost 0.1° of its zero.
fn with_a_shifted_zero() -> String {
    let text = std::fs::read_to_string(data("first_noisy.csv")).unwrap();
    let shifted = |line: &str| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        cells[4] = format!("{:.4}", cells[4].parse::<f64>().unwrap() + 0.1);
        cells.join(",")
    };
    let rows: Vec<String> = text.lines().skip(1).map(shifted).collect();
    format!("{}\n{}\n", text.lines().next().unwrap(), rows.join("\n"))
}

#[test]
fn a_robot_that_drifted_in_production_comes_first_and_its_figure_is_seen_on_a_phone() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    // by its name it would come last
    let drifted = plant.robot("Z in production", "ER20-0150");
    let set = |robot: &str, file: &str| plant.set(robot, file, file);
    let first = set(&drifted, "first_noisy.csv");
    let released = plant.calibrated(&drifted, &first, "least_squares");
    plant.release(&released, "the first one");
    let path = format!("/v1/robots/{drifted}/measurement-sets?frame=base&name=later");
    let newer = plant
        .server
        .create(&path, "text/csv", with_a_shifted_zero().into_bytes());
    plant.calibrated(&drifted, &newer, "least_squares");
    for name in ["A new", "B new"] {
        let robot = plant.robot(name, name);
        let points = set(&robot, "first_noisy.csv");
        plant.calibrated(&robot, &points, "least_squares");
    }
    let key = plant.key(&["read", "upload"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser
            .until("document.querySelector('tbody tr')?.innerText.includes('Z in production') && document.querySelector('tbody tr').innerText.includes('drifted')")
            .await;
        browser.until_it_says("A newer result puts the tool ").await;
        let chip = "[...document.querySelectorAll('.chip')].find((b) => b.innerText.startsWith('Drifted'))";
        browser
            .until(&format!("{chip}?.innerText.endsWith('1')"))
            .await;
        browser.run(&format!("{chip}.click()")).await;
        browser
            .until("document.querySelectorAll('.robots tbody tr').length === 1")
            .await;
        // both or neither say that a release would be refused
        browser.until_it_says("Release refused: ").await;
        for (size, dark) in [(DESKTOP, false), (PHONE, true)] {
            browser.look(Look { size, dark }).await;
            browser.go("/#/").await;
            browser
                .until("[...document.querySelectorAll('[data-drift]')].some((cell) => cell.checkVisibility() && cell.innerText.includes('mm'))")
                .await;
            assert_eq!(browser.accessibility().await, Vec::<String>::new());
        }
        browser
            .look(Look {
                size: DESKTOP,
                dark: false,
            })
            .await;
        browser
            .run("const s = document.querySelector('#robot-search'); s.value = 'no such robot'; s.dispatchEvent(new Event('input'))")
            .await;
        browser
            .until_it_says("No robot matches \"no such robot\".")
            .await;
        assert!(!browser.text().await.contains("choose All"));
        browser.go(&format!("/#/robots/{drifted}")).await;
        browser
            .until_it_says("A release would be refused now")
            .await;
        browser
            .until("document.querySelector('#drifted')?.innerText === 'drifted'")
            .await;
        browser.assert_quiet(&[]).await;
    });
}

#[test]
fn a_result_that_does_not_fit_is_called_so_everywhere() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 30", "ER20-0151");
    // the positions belong to other rows
    let text = std::fs::read_to_string(data("first_noisy.csv")).unwrap();
    let rows: Vec<Vec<&str>> = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').collect())
        .collect();
    let mut shuffled = format!("{}\n", text.lines().next().unwrap());
    for (i, row) in rows.iter().enumerate() {
        let other = &rows[(i * 37 + 11) % rows.len()];
        shuffled += &format!("{},{}\n", row[..8].join(","), other[8..].join(","));
    }
    let path = format!(
        "/v1/robots/{robot}/measurement-sets?frame=base&name=shuffled&insist=poor_alignment"
    );
    let set = plant
        .server
        .create(&path, "text/csv", shuffled.into_bytes());
    let job = plant.calibrated(&robot, &set, "least_squares");
    let key = plant.key(&["read"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("Release refused: ").await;
        let text = browser.text().await;
        assert!(
            text.contains("The first result is not ready to be released")
                && !text.contains("waits for its release"),
            "{text}"
        );
        let listed = browser
            .run("return document.querySelector('[data-error]').firstChild.textContent")
            .await;
        browser.go("/#/jobs").await;
        browser.until_it_says("does not fit").await;
        assert!(
            !browser
                .run("return document.querySelector('table').innerText")
                .await
                .as_str()
                .unwrap()
                .contains("succeeded")
        );
        let page = job_page(&job);
        browser.go(&page).await;
        browser
            .until("document.querySelector('[data-state]')?.innerText === 'does not fit'")
            .await;
        browser.go(&format!("/#/robots/{robot}")).await;
        browser.until_it_says("Error at identification").await;
        let text = browser.text().await;
        assert!(!text.contains("waits for its release"), "{text}");
        assert!(
            listed == "not verified" || text.contains(listed.as_str().unwrap()),
            "{listed}: {text}"
        );
        browser.assert_quiet(&[]).await;
    });
}

#[test]
fn pages_of_jobs_and_robots_follow_what_runs_and_an_archived_robot_asks_for_nothing() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 31", "ER20-0152");
    let set = plant.set(&robot, "first_noisy.csv", "first");
    let key = plant.key(&["read"]);
    let cancel = |job: &str| {
        let path = format!("/v1/jobs/{job}/cancel");
        let answer = in_place(|| plant.server.post(&path, "application/json", b"{}".to_vec()));
        assert!([200, 202].contains(&answer.0), "{}", answer.1);
    };
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("Cell 31").await;
        let badge = "document.querySelector('.robots tbody')?.innerText.includes('calibrating')";
        let job = in_place(|| plant.long_job(&robot, &set));
        browser.go("/#/").await;
        browser.until(&format!("{badge} === true")).await;
        cancel(&job);
        browser.until(&format!("{badge} === false")).await;
        let job = in_place(|| plant.long_job(&robot, &set));
        for page in ["/#/jobs".to_owned(), format!("/#/robots/{robot}")] {
            let job = match page.contains("robots") {
                true => in_place(|| plant.long_job(&robot, &set)),
                false => job.clone(),
            };
            browser.go(&page).await;
            let row = format!(
                "document.querySelector('tr a[href=\"#/jobs/{job}\"]')?.closest('tr')?.innerText"
            );
            browser
                .until(&format!("/running|queued/.test({row} ?? '')"))
                .await;
            cancel(&job);
            browser
                .until(&format!("({row} ?? '').includes('cancelled')"))
                .await;
        }
        // while it runs, its page shows the arm
        let job = in_place(|| plant.long_job(&robot, &set));
        // such a page is busy as long as the job runs
        browser
            .run(&format!("location.hash = '#/jobs/{job}'"))
            .await;
        browser
            .until("document.querySelector('progress') && document.querySelector('canvas.scene')")
            .await;
        cancel(&job);
        browser.until_it_says("The calibration was cancelled").await;
        let path = format!("/v1/robots/{robot}/archive");
        let body = json!({"reason": "sold"}).to_string().into_bytes();
        let (status, answer) =
            in_place(|| plant.server.post(&path, "application/json", body.clone()));
        assert_eq!(status, 200, "{answer}");
        browser.go(&format!("/#/robots/{robot}")).await;
        browser.until_it_says("This robot was archived").await;
        assert!(!browser.text().await.contains("What to do next"));
        browser.assert_quiet(&[]).await;
    });
}
