//! The dashboard in a real browser: Debian's Chromium on a real `kincal serve` with keys.
//!
//! `KINCAL_SCREENSHOTS=docs/pictures cargo test --test browser` also takes the pictures of docs/. `KINCAL_PAGES=FOLDER` saves every whole page, on a
//! desktop and on a tablet, for review.

#[path = "../support/mod.rs"]
mod support;
use support::process;

mod accessibility;
mod ambiguous_files;
mod arm;
mod browser;
mod consistency;
mod difficult_conditions;
mod first_steps;
mod fleet;
mod live_lists;
mod plant;
mod sessions;
mod two_files;
#[allow(dead_code)] // other tests write its other kinds
#[path = "../core/workbooks.rs"]
mod workbooks;

use browser::{Browser, Driver, Look, Picture};
use plant::{Plant, data, job_hash};
use process::{Server, run};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use thirtyfour::Key;

/// A name that runs a script if a page treats it as markup.
const HOSTILE: &str =
    "</script><script>alert(1)</script><img src=x onerror=alert(2)> \"' &amp; {{7*7}}";

/// Runs a user's steps in a new browser.
fn in_browser(driver: &Driver, server: &Server, steps: impl AsyncFnOnce(&Browser)) {
    in_browser_at(driver, &server.url, steps);
}

/// As [`in_browser`], on a server that may stop and start.
fn in_browser_at(driver: &Driver, url: &str, steps: impl AsyncFnOnce(&Browser)) {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let browser = Browser::open(driver, url, Look::default()).await;
        steps(&browser).await;
        browser.close().await;
    });
}

/// Signs in as a user does: types the key and presses Enter.
async fn sign_in(browser: &Browser, key: &str) {
    browser.go("/").await;
    browser.until("document.activeElement.id === 'key'").await;
    browser.press(key).await;
    browser.press(Key::Enter).await;
    // a page that is left meanwhile gives the request up
    browser
        .until("!document.querySelector('form.signin') || document.querySelector('form.signin .problem')")
        .await;
}

#[test]
fn a_set_is_uploaded_identified_read_released_and_withdrawn() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 4, welder left", "ER20-0117");
    let key = plant.key(&["read", "upload", "identify", "release"]);
    let faulty = faulty_csv(&plant);
    // As a spreadsheet saves it, with a byte order mark.
    let with_mark = format!(
        "\u{feff}{}",
        std::fs::read_to_string(data("first_noisy.csv")).unwrap()
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

        let field = browser.find("#set-file").await;
        field.send_keys(faulty.to_str().unwrap()).await.unwrap();
        browser.until_it_says("Nothing was stored").await;
        let fault = browser
            .find(".problem + .caption + .scroll tbody tr")
            .await
            .text()
            .await
            .unwrap();
        assert!(
            fault.starts_with("6 8 x_mm") && fault.contains("12,5"),
            "row, line, column and what stands there: {fault}"
        );
        browser
            .picture("upload-fault", Picture::Element("#calibrate"))
            .await;

        // somebody read the type plate
        let serial = browser.find("#stated-serial").await;
        serial.send_keys("ER20-0117").await.unwrap();
        browser
            .drop_file(".drop", "first_noisy.csv", &with_mark)
            .await;
        browser
            .until_it_says("100 points in 100 configurations")
            .await;
        // The next step is the calibration, no longer the measuring.
        browser
            .until("document.querySelector('.path .now')?.innerText.startsWith('Calibrate')")
            .await;
        browser
            .picture("upload", Picture::Element("#calibrate"))
            .await;
        browser
            .button("Start calibration")
            .await
            .click()
            .await
            .unwrap();
        browser.until("location.hash.startsWith('#/jobs/')").await;
        browser
            .until_it_says("On 50 points that were not fitted, the mean position error fell from")
            .await;
        for expected in [
            "Error per point",
            "Distribution of the errors",
            "Seen from above",
            "What could not be identified",
            "d₂ with d₃",
            "not seen alone",
            "candidate",
        ] {
            browser.until_it_says(expected).await;
        }
        assert_eq!(
            browser
                .run("return document.querySelectorAll('figure rect.after').length > 50")
                .await,
            true,
            "bars were drawn"
        );
        browser.picture("result", Picture::Top(1336)).await;

        browser.button("Release …").await.click().await.unwrap();
        browser
            .until_it_says("It may be released. Worth a look:")
            .await;
        let told = browser
            .find("dialog .warning ul")
            .await
            .text()
            .await
            .unwrap();
        assert!(
            told.contains("The verification has gaps: only points of the same upload")
                && !told.contains("No serial number says that it is the same robot: "),
            "{told}"
        );
        browser.picture("release", Picture::Element("dialog")).await;
        browser
            .find("dialog textarea")
            .await
            .send_keys("checked with the probe")
            .await
            .unwrap();
        browser.button("Release").await.click().await.unwrap();
        browser.until_it_says("now uses this set").await;
        browser
            .until("document.querySelector('section.card .badge.good')?.innerText === 'released'")
            .await;

        browser.button("Withdraw …").await.click().await.unwrap();
        browser
            .find("dialog textarea")
            .await
            .send_keys("the probe was wrong")
            .await
            .unwrap();
        browser.button("Withdraw").await.click().await.unwrap();
        browser
            .until_it_says("It was taken back and cannot be released any more")
            .await;
        assert!(!browser.text().await.contains("Release …"));
        browser.assert_quiet(&[422]).await;
    });
    let (status, _) = plant
        .server
        .get(&format!("/v1/robots/{robot}/parameter-sets/active"));
    assert_eq!(status, 404, "what was withdrawn is not active");
    let (_, sets) = plant
        .server
        .get(&format!("/v1/robots/{robot}/measurement-sets"));
    assert_eq!(
        sets["items"].as_array().unwrap().len(),
        1,
        "the faulty file left nothing"
    );
    assert_eq!(
        sets["items"][0]["sha256"],
        kincal::wire::canonical::sha256_hex(with_mark.as_bytes()),
        "kept byte for byte"
    );
}

#[test]
fn what_the_service_says_stands_on_the_pages() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 9", "ER20-0122");
    plant.release(
        &plant.identified(&robot, "first_noisy.csv"),
        "the first one",
    );
    let visited = plant.file("revisited.csv", &revisited_csv());
    let path = format!("/v1/robots/{robot}/measurement-sets?frame=base&name=revisited");
    let set = plant
        .server
        .create(&path, "text/csv", std::fs::read(visited).unwrap());
    let newest = plant.calibrated(&robot, &set, "least_squares");
    let [active, newest_set] = ["active", newest["parameter_set_id"].as_str().unwrap()];
    let (_, active) = plant
        .server
        .get(&format!("/v1/robots/{robot}/parameter-sets/{active}"));
    let key = plant.key(&["read", "release"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;

        // List and robot's page show the drift of the comparison.
        browser.until_it_says("newer result to review").await;
        let (_, compared) = in_place(|| {
            plant.server.get(&format!(
                "/v1/parameter-sets/{newest_set}/compare?with={}",
                active["id"].as_str().unwrap()
            ))
        });
        // The list computes drifts after it is there.
        browser
            .until("document.querySelector('tbody td:nth-child(5)').innerText.includes('mm')")
            .await;
        let shown = browser
            .run("return document.querySelector('tbody td:nth-child(5)').innerText")
            .await;
        assert_eq!(
            lengths_mm(shown.as_str().unwrap()),
            [
                three_digits(&compared["mean_mm"]),
                three_digits(&compared["max_mm"])
            ],
            "{compared}"
        );
        browser
            .run(&format!("location.hash = '#/robots/{robot}'"))
            .await;
        browser.until_it_says("Next calibration").await;
        let shown = fact(browser, "Drift").await;
        assert_eq!(
            lengths_mm(&shown),
            [
                three_digits(&compared["mean_mm"]),
                three_digits(&compared["max_mm"])
            ],
            "{shown}"
        );
        assert!(
            shown.contains("more than chance"),
            "{shown}: {}",
            compared["sessions"]["probability"]
        );

        // The forecast of the next calibration, with the service's text.
        let (_, history) = in_place(|| {
            plant
                .server
                .get(&format!("/v1/robots/{robot}/history?limit=1"))
        });
        let detail = history["trend"]["detail"].as_str().unwrap();
        assert_eq!(
            history["trend"]["days_to_limit"],
            Value::Null,
            "one session is no trend"
        );
        let shown = fact(browser, "Next calibration").await;
        assert!(
            shown.contains("cannot be said yet")
                && shown.to_lowercase().contains(&detail.to_lowercase()),
            "{shown}: {detail}"
        );

        // Repeatability of the robot.
        browser
            .run(&format!(
                "location.hash = '#/jobs/{}'",
                newest["id"].as_str().unwrap()
            ))
            .await;
        browser.until_it_says("Repeatability").await;
        let rows = browser
            .run("return document.querySelectorAll('[aria-label^=\"RP \"] tbody tr').length")
            .await;
        assert_eq!(rows, 3, "three poses were visited several times");
        // Changes have a unit.
        browser.until_it_says("Moved since the set before").await;
        let units = "return [...document.querySelectorAll('[aria-label^=\"Changes that\"] tbody td:nth-child(2)')].map((cell) => cell.innerText)";
        let units = browser.run(units).await;
        let units: Vec<&str> = units
            .as_array()
            .unwrap()
            .iter()
            .map(|unit| unit.as_str().unwrap())
            .collect();
        assert!(
            !units.is_empty() && units.iter().all(|unit| ["mm", "°"].contains(unit)),
            "{units:?}"
        );

        // Exports of the links.
        let folder = plant.folder.path().join("downloads");
        browser.download_to(&folder).await;
        for (name, format) in [("URDF", "urdf"), ("CSV", "csv"), ("YAML", "yaml")] {
            browser
                .button(&format!("… as {name}"))
                .await
                .click()
                .await
                .unwrap();
            // after the robot's name and the measuring date
            let ending = format!("_{newest_set}.{format}");
            let file = browser.downloaded(&folder, &ending).await;
            let served = in_place(|| {
                plant.server.text(&format!(
                    "/v1/parameter-sets/{newest_set}/export?format={format}"
                ))
            });
            assert_eq!(std::fs::read_to_string(file).unwrap(), served, "{name}");
        }
        browser.assert_quiet(&[]).await;

        // If the robot's policy would refuse a release, the dialog says so before a reason is written, and nothing is released.
        let policy = json!({"independent_session_required": true});
        in_place(|| {
            assert_eq!(
                plant
                    .server
                    .put(&format!("/v1/robots/{robot}/policy"), &policy)
                    .0,
                200
            )
        });
        browser.button("Release …").await.click().await.unwrap();
        browser.until_it_says("A release would be refused:").await;
        let told = browser
            .find("dialog .problem ul")
            .await
            .text()
            .await
            .unwrap();
        assert!(
            told.contains("The verification is not strong enough: only points of the same upload"),
            "{told}"
        );
        browser
            .find("dialog textarea")
            .await
            .send_keys("all the same")
            .await
            .unwrap();
        browser.button("Release").await.click().await.unwrap();
        browser.until_it_says("It was not released.").await;
        assert!(
            browser
                .find("dialog [role=alert]")
                .await
                .text()
                .await
                .unwrap()
                .contains("The verification is not strong enough: ")
        );
        browser.button("Not now").await.click().await.unwrap();
        // The list says so, too.
        browser.go("/#/").await;
        browser
            .until_it_says("Release refused: the verification is not strong enough")
            .await;
        browser.assert_quiet(&[409]).await;
    });
    let (_, still) = plant
        .server
        .get(&format!("/v1/robots/{robot}/parameter-sets/active"));
    assert_eq!(still["id"], active["id"]);
}

/// Sends a request from within a browser's steps. The tests' client has its own tokio runtime.
fn in_place<T: Send>(ask: impl FnOnce() -> T + Send) -> T {
    std::thread::scope(|scope| scope.spawn(ask).join().unwrap())
}

/// Value and note of one of the large numbers.
async fn fact(browser: &Browser, name: &str) -> String {
    let script = format!(
        "return [...document.querySelectorAll('.fact')].find((f) => f.firstChild.innerText === {}).innerText",
        json!(name)
    );
    browser.run(&script).await.as_str().unwrap().to_owned()
}

/// The numbers of a text.
fn lengths_mm(text: &str) -> Vec<f64> {
    text.split(|c: char| !c.is_ascii_digit() && c != '.')
        .filter_map(|word| word.parse().ok())
        .collect()
}

/// A length with the digits that the pages show.
fn three_digits(value: &Value) -> f64 {
    format!("{:.2e}", value.as_f64().unwrap()).parse().unwrap()
}

/// A set of the drifted robot in which three poses were measured four times, to 0.03 mm.
fn revisited_csv() -> String {
    let text = std::fs::read_to_string(data("followup_drifted.csv")).unwrap();
    let column = text
        .lines()
        .next()
        .unwrap()
        .split(',')
        .position(|name| name == "x_mm")
        .unwrap();
    let again = |(visit, line): (usize, &str)| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        cells[column] =
            (cells[column].parse::<f64>().unwrap() + [-0.03, 0.0, 0.02][visit]).to_string();
        cells.join(",") + "\n"
    };
    let more: String = (0..3)
        .flat_map(|visit| text.lines().skip(1).take(3).map(move |line| (visit, line)))
        .map(again)
        .collect();
    format!("{}\n{more}", text.trim_end())
}

/// A set whose eighth line has a decimal comma, as a spreadsheet writes it.
fn faulty_csv(plant: &Plant) -> PathBuf {
    let text = std::fs::read_to_string(data("first.csv")).unwrap();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let column = lines[0].split(',').position(|name| name == "x_mm").unwrap();
    let mut cells: Vec<&str> = lines[7].split(',').collect();
    cells[column] = "\"12,5\"";
    lines[7] = cells.join(",");
    plant.file("faulty.csv", &lines.join("\n"))
}

#[test]
fn a_running_job_is_followed_and_cancelled() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 5", "ER20-0118");
    let set = plant.set(&robot, "first_noisy.csv", "first");
    let job = plant.long_job(&robot, &set);
    let key = plant.key(&["read", "identify"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("calibrating").await;
        browser
            .run(&format!("location.hash = '#/jobs/{job}'"))
            .await;
        browser
            .until("document.querySelector('progress')?.value > 20")
            .await;
        browser
            .until("document.querySelector('.after-line')?.getAttribute('d').length > 100")
            .await;
        browser.until_it_says("Particle swarm: iteration").await;
        browser.picture("running", Picture::Top(700)).await;
        let before = browser
            .run("return document.querySelector('progress').value")
            .await
            .as_f64()
            .unwrap();
        browser
            .until(&format!(
                "document.querySelector('progress').value > {before}"
            ))
            .await;
        browser.button("Cancel").await.click().await.unwrap();
        browser.until_it_says("The calibration was cancelled").await;
        browser.assert_quiet(&[]).await;
    });
    assert_eq!(plant.server.finished(&job)["status"], "cancelled");
}

#[test]
fn a_key_opens_what_it_may_and_names_are_only_names() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot(HOSTILE, HOSTILE);
    let set = plant.set(&robot, "first_noisy.csv", HOSTILE);
    let job = plant.calibrated(&robot, &set, "least_squares");
    let key = plant.key(&["read"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, "kincal_0000").await;
        browser
            .until_it_says("this key is not known or was revoked")
            .await;
        assert_eq!(
            browser
                .run("return [sessionStorage.length, localStorage.length, document.cookie.length]")
                .await,
            json!([0, 0, 0])
        );
        browser.until("document.activeElement.id === 'key'").await;
        browser.press(key.as_str()).await;
        browser.press(Key::Enter).await;
        browser.until_it_says("test: read").await;
        for hash in ["#/".into(), format!("#/robots/{robot}"), job_hash(&job)] {
            browser
                .run(&format!("location.hash = {}", json!(hash)))
                .await;
            browser.until_it_says(HOSTILE).await;
            browser.settled().await;
            assert_eq!(
                browser
                    .run("return document.querySelectorAll('main img, main script').length")
                    .await,
                0,
                "{hash}"
            );
            let text = browser.text().await;
            for forbidden in [
                "Release …",
                "Withdraw …",
                "Start calibration",
                "Add robot",
                "Drop a measurement set",
            ] {
                assert!(
                    !text.contains(forbidden),
                    "{hash} offers {forbidden} to a reader"
                );
            }
        }
        browser.button("Sign out").await.click().await.unwrap();
        browser.until_it_says("API key").await;
        assert_eq!(browser.run("return sessionStorage.length").await, 0);
        browser.assert_quiet(&[401]).await;
    });
}

#[test]
fn the_report_is_a_page_that_prints() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let page = plant.folder.path().join("report.html");
    let (robot, set) = (data("robot.json"), data("first_noisy.csv"));
    let arguments = [
        "calibrate",
        robot.to_str().unwrap(),
        set.to_str().unwrap(),
        "--method",
        "pso",
        "--html",
        page.to_str().unwrap(),
    ];
    let output = run(&arguments);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        browser.go_to_file(&page).await;
        browser
            .until_it_says("Position errors before and after")
            .await;
        assert_eq!(
            browser
                .run("return getComputedStyle(document.querySelector('.after')).fill")
                .await,
            "rgb(10, 58, 107)",
            "the style is let in"
        );
        assert_eq!(browser.accessibility().await, Vec::<String>::new());
        assert_eq!(browser.console().await, Vec::<String>::new());
        let requests = browser.requests().await;
        assert!(
            requests
                .iter()
                .all(|url| url.starts_with("file://") && url.ends_with("report.html")),
            "{requests:?}"
        );
        let pdf = browser.printed().await;
        let pages = String::from_utf8_lossy(&pdf)
            .matches("/Type /Page\n")
            .count();
        assert!((2..=4).contains(&pages), "{pages} pages");
        if let Some(folder) = std::env::var_os("KINCAL_PAGES") {
            std::fs::write(Path::new(&folder).join("report.pdf"), pdf).unwrap();
        }
        browser.picture("report", Picture::Top(1000)).await;
    });
}
