//! Accessibility of every page: on a desktop and on a tablet, in both themes, and with the keyboard alone.

use crate::browser::{Browser, DESKTOP, Driver, Look, Picture, TABLET};
use crate::hall::Plant;
use crate::{in_browser, sign_in};
use serde_json::{Value, json};
use thirtyfour::Key;

#[test]
fn every_page_is_accessible_in_both_themes_and_fits_a_tablet() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let hall = Plant::open();
    let robot = hall.robot("Cell 6, handling", "ER20-0119");
    let mut last = Value::Null;
    for (file, method) in [
        ("first_noisy.csv", "pso"),
        ("followup_unchanged.csv", "bpnn_pso"),
        ("followup_drifted.csv", "bpnn_pso"),
    ] {
        last = hall.calibrated(&robot, &hall.set(&robot, file, file), method);
        if file == "first_noisy.csv" {
            hall.release(&last, "the first one");
        }
    }
    hall.robot("Cell 7, not measured yet", "ER20-0120");
    let job = last["id"].as_str().unwrap();
    let key = hall.key(&["admin"]);
    in_browser(&driver, &hall.server, async |browser: &Browser| {
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
    let hall = Plant::open();
    let robot = hall.robot("Cell 8", "ER20-0121");
    let job = hall.calibrated(
        &robot,
        &hall.set(&robot, "first_noisy.csv", "first"),
        "least_squares",
    );
    let key = hall.key(&["admin"]);
    in_browser(&driver, &hall.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("result to review").await;
        for hash in [
            "#/".to_owned(),
            format!("#/robots/{robot}"),
            format!("#/jobs/{}", job["id"].as_str().unwrap()),
        ] {
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
    let (_, active) = hall
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
