//! The dashboard under difficult conditions: another key, a server that is down, large sets and long histories.

use crate::browser::{Browser, Driver};
use crate::plant::{Plant, data};
use crate::process::{Server, kincal};
use crate::{in_browser, in_browser_at, in_place, sign_in};
use serde_json::{Value, json};
use thirtyfour::Key;

/// Number of parameter sets that the dashboard lists at once.
const LISTED: usize = 200;

#[test]
fn a_key_that_opens_nothing_leads_back_to_the_sign_in() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    plant.robot("Cell 1", "ER20-0101");
    let (no_reader, reader) = (plant.key(&["upload"]), plant.key(&["read"]));
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &no_reader).await;
        browser.until_it_says("This key may not read").await;
        // Keys as an editor or a chat program changes them.
        for (wrong, said) in [
            ("kincal_„ключ“", "This is not a key"),
            ("kincal_é", "This is not a key"),
        ] {
            browser.until("document.activeElement.id === 'key'").await;
            browser.press(wrong).await;
            browser.press(Key::Enter).await;
            browser.until_it_says(said).await;
            assert_eq!(browser.run("return sessionStorage.length").await, 0);
        }
        browser.until("document.activeElement.id === 'key'").await;
        browser.press(reader.as_str()).await;
        browser.press(Key::Enter).await;
        browser.until_it_says("test: read").await;
        browser.assert_quiet(&[403]).await;
    });
}

#[test]
fn a_live_job_outlives_a_restart_of_the_server() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 2", "ER20-0102");
    let set = plant.set(&robot, "first_noisy.csv", "first");
    let job = plant.long_job(&robot, &set);
    let key = plant.key(&["read", "identify"]);
    let Plant { server, folder } = plant;
    let url = server.url.clone();
    // The second server ends after the browser, because it cannot end within the browser's steps.
    let (mut server, mut again) = (Some(server), None);
    in_browser_at(&driver, &url, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("calibrating").await;
        browser
            .run(&format!("location.hash = '#/jobs/{job}'"))
            .await;
        browser
            .until("document.querySelector('progress')?.value > 5")
            .await;
        in_place(|| server.take().unwrap().terminate());
        browser
            .until_it_says("The server does not answer. This page waits for it")
            .await;
        let mut command = kincal(&[
            "serve",
            "--listen",
            url.strip_prefix("http://").unwrap(),
            "--workers",
            "1",
            "--data-dir",
        ]);
        command.arg(folder.path().join("data"));
        again = Some(in_place(|| Server::of(command)));
        browser.until_it_says(": iteration ").await;
        browser.button("Cancel").await.click().await.unwrap();
        browser.until_it_says("The calibration was cancelled").await;
    });
    drop(again);
}

#[test]
fn the_active_set_is_found_however_many_came_after_it() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 3", "ER20-0103");
    let set = plant.set(&robot, "first_noisy.csv", "first");
    let request =
        json!({"measurement_set_id": set, "method": "least_squares", "corrections": "off"});
    let ask = || plant.server.job(&robot, &request);
    let first = plant.server.finished(&ask());
    plant.release(&first, "the first one");
    let asked: Vec<_> = (0..LISTED).map(|_| ask()).collect();
    let last = asked.last().unwrap();
    plant.server.finished(last);
    let key = plant.key(&["read"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("newer result to review").await;
        let active = browser
            .run("return document.querySelector('tbody td:nth-child(3)').innerText")
            .await;
        assert_ne!(active, "none");
        browser
            .run(&format!("location.hash = '#/robots/{robot}'"))
            .await;
        browser
            .until_it_says("Error at identification (active set)")
            .await;
        let path = format!("a[href='#/jobs/{}']", first["id"].as_str().unwrap());
        let row = browser
            .run(&format!(
                "return document.querySelector({}).closest('tr').innerText",
                json!(path)
            ))
            .await;
        assert!(row.as_str().unwrap().contains("released"), "{row}");
        browser.assert_quiet(&[]).await;
    });
}

#[test]
fn what_cannot_be_fetched_is_said_and_robots_are_listed_once() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 4", "ER20-0104");
    let text = json_set();
    let path = format!("/v1/robots/{robot}/measurement-sets?frame=base&name=by%20hand");
    plant
        .server
        .create(&path, "application/json", text.clone().into_bytes());
    for i in 0..24 {
        plant.robot(&format!("Other {i}"), &format!("ER20-1{i:03}"));
    }
    let key = plant.key(&["read"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("Show more").await;
        browser
            .run("const b = [...document.querySelectorAll('button')].find((b) => b.innerText === 'Show more'); b.click(); b.click()")
            .await;
        browser.until("document.querySelectorAll('tbody tr').length >= 25 && !document.body.innerText.includes('Show more')").await;
        assert_eq!(
            browser
                .run("return document.querySelectorAll('tbody tr').length")
                .await,
            25
        );

        let folder = plant.folder.path().join("downloads");
        browser.download_to(&folder).await;
        browser
            .run(&format!("location.hash = '#/robots/{robot}'"))
            .await;
        browser.until_it_says("by hand").await;
        browser.button("Download").await.click().await.unwrap();
        let file = folder.join("by hand.json");
        browser.until_there_is(&file).await;
        assert_eq!(
            std::fs::read_to_string(file).unwrap(),
            text,
            "a JSON upload is a JSON download"
        );
        browser.assert_quiet(&[]).await;

        // As if the session had ended meanwhile.
        browser
            .set_cookie("kincal_session", "kincal_0000", "/v1")
            .await;
        browser.button("Download").await.click().await.unwrap();
        browser
            .until_it_says("Nothing was downloaded: the session of this browser has ended")
            .await;
        browser.assert_quiet(&[401]).await;
    });
}

/// The paper's first set with its joint values changed, under the same names.
fn with_joints(change: impl Fn(usize, f64) -> f64) -> String {
    let changed = |line: &String| {
        let cells = line.split(',').enumerate().map(|(at, cell)| match at {
            2..8 => change(at - 1, cell.parse().unwrap()).to_string(),
            _ => cell.to_owned(),
        });
        cells.collect::<Vec<_>>().join(",")
    };
    let lines = lines();
    let rows: Vec<String> = lines[1..].iter().map(changed).collect();
    format!("{}\n{}\n", lines[0], rows.join("\n"))
}

#[test]
fn a_wrong_file_is_read_as_the_refusal_says_by_one_click() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 25", "ER20-0145");
    let key = plant.key(&["read", "upload"]);
    let radians = with_joints(|_, q_deg| q_deg.to_radians());
    let other_way = with_joints(|joint, q_deg| if joint == 2 { -q_deg } else { q_deg });
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("not calibrated").await;
        browser.go(&format!("/#/robots/{robot}")).await;
        browser.until("document.querySelector('#set-file')").await;
        browser.drop_file(".drop", "radians.csv", &radians).await;
        browser
            .button("Read the joints as radians")
            .await
            .click()
            .await
            .unwrap();
        browser.until_it_says("radians: 100 points in 100").await;
        browser.drop_file(".drop", "other.csv", &other_way).await;
        browser
            .until_it_says("Joint 2 is counted the other way round.")
            .await;
        assert!(
            !browser.text().await.contains("coupling"),
            "no joint map as JSON"
        );
        browser
            .button("Store this joint map with the robot, and read the file so")
            .await
            .click()
            .await
            .unwrap();
        browser.until_it_says("other: 100 points in 100").await;
        browser.assert_quiet(&[422]).await;
    });
    let (_, stored) = plant.server.get(&format!("/v1/robots/{robot}"));
    assert_eq!(stored["joint_map"]["sign"][1], json!(-1.0));
}

/// The lines of the paper's first set.
fn lines() -> Vec<String> {
    std::fs::read_to_string(data("first_noisy.csv"))
        .unwrap()
        .lines()
        .map(str::to_owned)
        .collect()
}

/// Some points of the paper's first set, as JSON.
fn json_set() -> String {
    let points: Vec<Value> = lines()[1..]
        .iter()
        .map(|line| {
            let numbers: Vec<f64> = line
                .split(',')
                .skip(2)
                .map(|cell| cell.parse().unwrap())
                .collect();
            json!({"q_deg": numbers[..6], "position_mm": numbers[6..]})
        })
        .collect();
    json!({"points": points}).to_string()
}

#[test]
fn faults_are_shown_on_the_lines_that_an_editor_has_them_on() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 5", "ER20-0105");
    let key = plant.key(&["read", "upload"]);
    let lines = lines();
    let of = |i: usize| lines[i].split_once(',').unwrap().1;
    // Line 1 is the header, 2 is row 0, 3 is empty, 4 has spaces, 5 and 6 are row 1, 7 is row 2.
    let wrong = of(3).replace(lines[3].rsplit(',').next().unwrap(), "12 mm");
    let text = format!(
        "{}\n0,{}\n\n   \n\"one\n two\",{}\n2,{wrong}\n",
        lines[0],
        of(1),
        of(2)
    );
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("not calibrated").await;
        browser
            .run(&format!("location.hash = '#/robots/{robot}'"))
            .await;
        browser
            .until_it_says("This robot has not been calibrated yet")
            .await;
        browser.drop_file(".drop", "gaps.csv", &text).await;
        browser.until_it_says("Nothing was stored").await;
        let rows = browser
            .run("return [...document.querySelectorAll('.problem + .caption + .scroll tbody tr')].map((row) => row.innerText)")
            .await;
        let rows: Vec<String> = rows
            .as_array()
            .unwrap()
            .iter()
            .map(|row| row.as_str().unwrap().replace('\t', " "))
            .collect();
        assert_eq!(rows.len(), 1, "blank lines are no fault: {rows:#?}");
        assert!(
            rows[0].starts_with("2 7 z_mm 12 mm "),
            "the cell that is no number: {rows:#?}"
        );
        browser.assert_quiet(&[422]).await;
    });
}

#[test]
fn a_large_set_is_drawn_with_as_many_arrows_as_can_be_told_apart() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 6", "ER20-0106");
    let lines = lines();
    let x_at = lines[0].split(',').position(|name| name == "x_mm").unwrap();
    // measured again, so no two rows are alike
    let rows = (0..2500).map(|i| {
        let mut cells: Vec<String> = lines[1 + i % 100].split(',').map(str::to_owned).collect();
        cells[0] = i.to_string();
        let x_mm: f64 = cells[x_at].parse().unwrap();
        cells[x_at] = format!("{:.6}", x_mm + 1e-6 * i as f64);
        cells.join(",") + "\n"
    });
    let text = format!("{}\n{}", lines[0], rows.collect::<String>());
    let set = plant.server.create(
        &format!("/v1/robots/{robot}/measurement-sets?frame=base&name=large"),
        "text/csv",
        text.into_bytes(),
    );
    let job = plant.server.job(
        &robot,
        &json!({"measurement_set_id": set, "method": "least_squares", "corrections": "off"}),
    );
    plant.server.finished(&job);
    let key = plant.key(&["read"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("result to review").await;
        browser
            .run(&format!("location.hash = '#/jobs/{job}'"))
            .await;
        browser
            .until_it_says("Drawn are an even sample, one of every 2 points, and the 20 points with the largest errors after calibration: 1,2")
            .await;
        let drawn = "return Number(document.querySelector('canvas.scene').dataset.drawn)";
        let drawn = browser.run(drawn).await.as_u64().unwrap();
        assert!((1250..=1270).contains(&drawn), "{drawn}");
        // an even sample is not worse than all points: half of it is below the median of all
        let script = format!(
            "return Promise.all([import('/assets/arm.js'), fetch('/v1/jobs/{job}/report').then((answer) => answer.json())]).then(([{{ quantile, thinned }}, {{ per_point: points }}]) => {{ \
                const all = points.map((p) => ({{ errors: {{ after: p.after_mm }} }})); const drawn = thinned(all, all.map(() => [0, 0, 0]), 2, 'after'); \
                const median = quantile(points.map((p) => p.after_mm), 0.5); const kept = points.filter((_, i) => drawn[i]); \
                return kept.filter((p) => p.after_mm > median).length / kept.length; }})"
        );
        let above = browser.run(&script).await.as_f64().unwrap();
        assert!(
            (0.4..0.6).contains(&above),
            "{above} of the sample are above the median"
        );
        browser.assert_quiet(&[]).await;
    });
}
