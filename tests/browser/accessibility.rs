//! Accessibility of every page: on a desktop and on a tablet, in both themes, and with the keyboard alone.

use crate::browser::{Browser, DESKTOP, Driver, Look, Picture, TABLET};
use crate::plant::{Plant, job_hash};
use crate::{in_browser, in_place, sign_in};
use serde_json::{Value, json};
use thirtyfour::Key;

#[test]
fn every_page_is_accessible_in_both_themes_and_fits_a_tablet() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 6, handling", "ER20-0119");
    let mut last = Value::Null;
    for (file, method) in [
        ("first_noisy.csv", "pso"),
        ("followup_unchanged.csv", "bpnn_pso"),
        ("followup_drifted.csv", "bpnn_pso"),
    ] {
        last = plant.calibrated(&robot, &plant.set(&robot, file, file), method);
        if file == "first_noisy.csv" {
            plant.release(&last, "the first one");
        }
    }
    plant.robot("Cell 7, not measured yet", "ER20-0120");
    let job = last["id"].as_str().unwrap();
    let key = plant.key(&["admin"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        browser.go("/").await;
        assert_eq!(
            browser.accessibility().await,
            Vec::<String>::new(),
            "sign in"
        );
        browser.picture("sign-in", Picture::Whole).await;
        sign_in(browser, &key).await;
        browser.until_it_says("newer result to review").await;
        let pages = [
            ("robots", "/#/".to_owned()),
            ("robot", format!("/#/robots/{robot}")),
            ("job", format!("/#/jobs/{job}")),
            ("api", "/docs".into()),
        ];
        for (size, dark) in [(DESKTOP, false), (TABLET, true)] {
            browser.look(Look { size, dark }).await;
            for (name, path) in &pages {
                browser.go(path).await;
                let shape = if dark { "tablet" } else { "desktop" };
                assert_eq!(
                    browser.accessibility().await,
                    Vec::<String>::new(),
                    "{name} on a {shape}"
                );
                let too_wide = browser
                    .run("return document.documentElement.scrollWidth > innerWidth")
                    .await;
                assert_eq!(too_wide, false, "{name} on a {shape}");
                assert_eq!(
                    hidden_by_scrolling(browser).await,
                    json!([]),
                    "{name} on a {shape}: tables that are cut off"
                );
                browser
                    .picture(&format!("{name}-{shape}"), Picture::Whole)
                    .await;
                if *name == "robot" && !dark {
                    browser.picture("robot", Picture::Top(1168)).await;
                }
            }
        }
        browser.assert_quiet(&[]).await;
    });
}

/// Captions of tables that do not fit beside each other without scrolling.
async fn hidden_by_scrolling(browser: &Browser) -> Value {
    browser.run("return [...document.querySelectorAll('.scroll')].filter((s) => s.scrollWidth > s.clientWidth + 1).map((s) => s.getAttribute('aria-label'))").await
}

#[test]
fn everything_is_within_reach_of_the_keyboard() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 8", "ER20-0121");
    let job = plant.identified(&robot, "first_noisy.csv");
    let key = plant.key(&["admin"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("result to review").await;
        for hash in ["#/".to_owned(), format!("#/robots/{robot}"), job_hash(&job)] {
            browser
                .run(&format!("location.hash = {}", json!(hash)))
                .await;
            browser
                .until("!document.querySelector('[aria-busy]')")
                .await;
            browser.settled().await;
            assert_eq!(out_of_reach(browser).await, Vec::<String>::new(), "{hash}");
        }
        // Releases without a mouse: the button, the dialog, the reason, the answer.
        browser.run("[...document.querySelectorAll('button')].find((b) => b.innerText === 'Release …').focus()").await;
        browser.press(Key::Enter).await;
        browser.until("document.querySelector('dialog').open && document.activeElement.tagName === 'TEXTAREA'").await;
        browser.press("by keyboard alone").await;
        browser.press(Key::Tab).await;
        browser.press(Key::Enter).await;
        browser.until_it_says("now uses this set").await;
        browser.assert_quiet(&[]).await;
    });
    let (_, active) = plant
        .server
        .get(&format!("/v1/robots/{robot}/parameter-sets/active"));
    assert_eq!(active["id"], job["parameter_set_id"]);
}

/// Elements that work with a mouse, but cannot be reached by Tab or do not show the focus.
async fn out_of_reach(browser: &Browser) -> Vec<String> {
    let mark = "document.activeElement?.blur(); window.scrollTo(0, 0); \
        window.waiting = [...document.querySelectorAll('a[href], button, input:not([type=radio]), select, textarea, summary')] \
        .filter((e) => e.checkVisibility() && !e.disabled && !e.closest('details:not([open])') || e.tagName === 'SUMMARY' && e.checkVisibility()); \
        return window.waiting.length";
    let n = browser.run(mark).await.as_u64().unwrap();
    assert!(n > 3, "there is something to reach");
    for _ in 0..4 * n {
        browser.press(Key::Tab).await;
        let met = "const e = document.activeElement; const seen = getComputedStyle(e).outlineStyle !== 'none'; \
            if (seen) window.waiting = window.waiting.filter((w) => w !== e); return window.waiting.length";
        if browser.run(met).await == 0 {
            return vec![];
        }
    }
    let left = browser
        .run("return window.waiting.map((e) => e.outerHTML.slice(0, 120))")
        .await;
    left.as_array()
        .unwrap()
        .iter()
        .map(|html| html.as_str().unwrap().to_owned())
        .collect()
}

/// Tools and work frames are kept from the page, and a program of Cartesian targets is corrected with them.
#[test]
fn tools_and_work_frames_are_kept_and_cartesian_targets_corrected() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 18", "ER20-0138");
    plant.identified(&robot, "first_noisy.csv");
    let q_deg = [10.0, -30.0, 20.0, 15.0, 40.0, 5.0];
    let body = json!({"q_deg": q_deg}).to_string().into_bytes();
    let path = format!("/v1/robots/{robot}/posture");
    let (status, posture) = plant.server.post(&path, "application/json", body);
    assert_eq!(status, 200, "{posture}");
    let key = plant.key(&["read", "upload"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("Cell 18").await;
        browser.go(&format!("/#/robots/{robot}/correct")).await;
        browser
            .until_it_says("Work frames (0), tools (0) and references (0) of the cell")
            .await;
        // The same rotation as three controllers write it; the service's own conversion is the other oracle.
        for (kind, field) in [
            ("abc", "kuka_abc_deg"),
            ("wpr", "fanuc_wpr_deg"),
            ("vector", "ur_rotation_vector_rad"),
        ] {
            let found = browser
                .run(&format!(
                    "const {{quaternion}} = await import('/assets/rotations.js'); return quaternion('{kind}', {})",
                    posture[field]
                ))
                .await;
            // q and −q are one rotation
            let sign = found[0].as_f64().unwrap().signum();
            for k in 0..4 {
                let [found, expected] =
                    [&found, &posture["quaternion"]].map(|q| q[k].as_f64().unwrap());
                assert!(
                    (sign * found - expected).abs() < 1e-6,
                    "{kind}: {found} {expected}"
                );
            }
        }
        browser
            .run(&format!(
                "const cell = document.getElementById('cell'); cell.open = true;
                 const form = cell.querySelectorAll('form')[0];
                 form.querySelector('#tool-name').value = 'gripper';
                 form.querySelectorAll('fieldset input').forEach((input, i) => {{ input.value = [0, 5, 120][i]; }});
                 const kind = form.querySelector('#tool-rotation');
                 kind.value = 'abc';
                 kind.dispatchEvent(new Event('change'));
                 form.querySelectorAll('span.controls input').forEach((input, i) => {{ input.value = {}[i]; }});",
                posture["kuka_abc_deg"]
            ))
            .await;
        browser.button("Store a tool").await.click().await.unwrap();
        browser.until_it_says("tools (1) and references").await;
        let (_, tool) = in_place(|| {
            plant
                .server
                .get(&format!("/v1/robots/{robot}/tools/gripper"))
        });
        assert_eq!(
            tool["t_flange_tool"]["translation_mm"],
            json!([0.0, 5.0, 120.0])
        );
        for (i, k) in (0..3).flat_map(|i| (0..3).map(move |k| (i, k))) {
            let [found, expected] = [&tool["t_flange_tool"]["rotation"], &posture["rotation"]]
                .map(|rotation| rotation[i][k].as_f64().unwrap());
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
        // A fixture that stands 10, 20, 30 mm from the base frame, from four points.
        let points = "nominal_x_mm,nominal_y_mm,nominal_z_mm,x_mm,y_mm,z_mm\n0,0,0,10,20,30\n300,0,0,310,20,30\n0,200,0,10,220,30\n300,200,50,310,220,80\n";
        give(browser, "#frame-file", "fixture.csv", points).await;
        browser
            .run("document.querySelector('#frame-name').value = 'table'")
            .await;
        browser
            .button("Store a work frame")
            .await
            .click()
            .await
            .unwrap();
        browser.until_it_says("Work frames (1)").await;
        let (_, frame) = in_place(|| {
            plant
                .server
                .get(&format!("/v1/robots/{robot}/work-frames/table"))
        });
        let origin = &frame["t_reference_work"]["translation_mm"];
        for (k, expected) in [10.0, 20.0, 30.0].into_iter().enumerate() {
            assert!(
                (origin[k].as_f64().unwrap() - expected).abs() < 1e-9,
                "{frame}"
            );
        }
        let residuals = browser.text().await;
        assert!(
            residuals.contains("Residual of each point of table"),
            "{residuals}"
        );
        browser.picture("cell", Picture::Whole).await;
        // The reflector of this set sits on the flange: the posture, in the fixture's frame.
        let at = |k: usize| posture["position_mm"][k].as_f64().unwrap() - [10.0, 20.0, 30.0][k];
        let joints = q_deg.map(|q| q.to_string()).join(",");
        let program = format!(
            "name,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\nweld 1,{joints},{},{},{}\n",
            at(0),
            at(1),
            at(2)
        );
        give(browser, "#correct-file", "program.csv", &program).await;
        browser
            .run("document.querySelector('#correct-frame').value = 'table'; document.querySelector('#correct-mode').value = 'position'")
            .await;
        browser.button("Correct").await.click().await.unwrap();
        browser.until_it_says("Largest error after").await;
        let said = browser.text().await;
        assert!(
            said.contains("Known to") && said.contains("all targets are corrected"),
            "{said}"
        );
        assert_eq!(browser.accessibility().await, Vec::<String>::new());
        browser.assert_quiet(&[]).await;
    });
}

/// The service reads a program and writes it again; the page asks what its columns do not say, and offers the bytes as they came.
#[test]
fn a_program_comes_back_in_its_own_form_and_faults_name_its_lines() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 23", "ER20-0143");
    let job = plant.identified(&robot, "first_noisy.csv");
    let set = job["parameter_set_id"].as_str().unwrap();
    let key = plant.key(&["read"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("Cell 23").await;
        browser.go(&format!("/#/robots/{robot}/correct")).await;
        browser.until_it_says("Correct a program").await;
        let program = "# made offline\r\nName;A1;A2;A3;A4;A5;A6;Remark\r\nP1;10,5;-30;20;15;40;5;\"a; b\"\r\n\r\nP2;12;-30;20;15;40;5;\r\n";
        let wrong = program.replace("12;-30", "12;zero");
        give(browser, "#correct-file", "wrong.csv", &wrong).await;
        browser.button("Correct").await.click().await.unwrap();
        browser
            .until_it_says("In which unit are the joint values?")
            .await;
        browser.button("Degrees").await.click().await.unwrap();
        browser.until_it_says("Line 5: column A2").await;
        give(browser, "#correct-file", "program.csv", program).await;
        browser.button("Correct").await.click().await.unwrap();
        browser
            .until_it_says("In which unit are the joint values?")
            .await;
        browser.button("Degrees").await.click().await.unwrap();
        browser.until_it_says("Largest error after").await;
        let lines = "return [...document.querySelectorAll('tbody tr')].map((row) => row.cells[0].innerText)";
        assert_eq!(browser.run(lines).await, json!(["3", "5"]));
        browser.picture("corrected", Picture::Whole).await;
        let folder = plant.folder.path().join("downloads");
        browser.download_to(&folder).await;
        browser
            .button("Download the corrected program")
            .await
            .click()
            .await
            .unwrap();
        let file = folder.join("program-corrected-for-trial.csv");
        browser.until_there_is(&file).await;
        let found = std::fs::read_to_string(&file).unwrap();
        let q = json!({"q_deg": [[10.5, -30.0, 20.0, 15.0, 40.0, 5.0]]});
        let path = format!("/v1/parameter-sets/{set}/compensate");
        let body = q.to_string().into_bytes();
        let (_, wanted) = in_place(|| plant.server.post(&path, "application/json", body));
        let first = wanted["q_deg"][0][0].as_f64().unwrap();
        let first = format!("{first:.7}").replace('.', ",");
        assert!(
            found.starts_with("# made offline\r\nName;A1;A2;A3;A4;A5;A6;Remark\r\nP1;")
                && found.contains(&format!("P1;{first};"))
                && found.contains(";\"a; b\"\r\n\r\nP2;"),
            "{first}: {found}"
        );
        assert_eq!(browser.accessibility().await, Vec::<String>::new());
        browser.assert_quiet(&[422]).await;
    });
}

/// Puts a file into a field for files.
async fn give(browser: &Browser, css: &str, name: &str, content: &str) {
    let content = json!(content);
    let script = format!(
        "const given = new DataTransfer(); given.items.add(new File([{content}], '{name}', {{type: 'text/csv'}}));
         document.querySelector('{css}').files = given.files;"
    );
    browser.run(&script).await;
}
