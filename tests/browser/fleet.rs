//! Two hundred robots: who needs work, why, and how soon the list says so.

use crate::browser::{Browser, Driver};
use crate::plant::Plant;
use crate::{in_browser, sign_in};

const N_ROBOTS: usize = 200;

#[test]
fn two_hundred_robots_are_found_by_what_they_need() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let ids: Vec<String> = (0..N_ROBOTS)
        .map(|i| {
            plant.robot(
                &format!("Line {}, station {i:03}", i / 20),
                &format!("SN-{i:04}"),
            )
        })
        .collect();
    // One waits for its first release; one was released.
    let calibrated = |i: usize| plant.identified(&ids[i], "first_noisy.csv");
    calibrated(17);
    plant.release(&calibrated(42), "in order");
    let key = plant.key(&["read"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("200 robots; one needs you.").await;
        let first = browser
            .run("return document.querySelector('tbody tr').innerText")
            .await;
        let first = first.as_str().unwrap();
        assert!(
            first.contains("station 017") && first.contains("result to review"),
            "what needs somebody comes first: {first}"
        );
        browser.until_it_says("20 of 200").await;

        // One request for the list, whatever the number of robots: no page of its own for each.
        let asked = browser.requests().await;
        let lists = asked.iter().filter(|url| url.contains("/v1/")).count();
        assert!(lists <= 5, "{asked:?}");

        // By serial number, by need, and back.
        let type_into = "const s = document.querySelector('#robot-search'); s.value = arguments_0; s.dispatchEvent(new Event('input'))";
        browser
            .run(&type_into.replace("arguments_0", "'sn-0042'"))
            .await;
        browser
            .until("document.querySelectorAll('tbody tr').length === 1")
            .await;
        browser
            .until_it_says("1 of 1 that match, of 200 robots")
            .await;
        browser.run(&type_into.replace("arguments_0", "''")).await;
        browser
            .run("[...document.querySelectorAll('.chip')].find((b) => b.innerText.startsWith('In order')).click()")
            .await;
        browser
            .until("document.querySelectorAll('tbody tr').length === 1 && document.querySelector('tbody tr').innerText.includes('station 042')")
            .await;
        browser
            .run("[...document.querySelectorAll('.chip')].find((b) => b.innerText.startsWith('All')).click()")
            .await;
        browser
            .run("const s = document.querySelector('#robot-sort'); s.value = 'name'; s.dispatchEvent(new Event('change'))")
            .await;
        browser
            .until("document.querySelector('tbody tr').innerText.includes('station 000')")
            .await;
        browser.button("Show more").await.click().await.unwrap();
        browser
            .until("document.querySelectorAll('tbody tr').length === 120")
            .await;
        // the keyboard goes on at the first robot that came
        browser
            .until("[...document.querySelectorAll('tbody tr')].indexOf(document.activeElement.closest('tr')) > 0")
            .await;
        // What a reader may not do is said, with the scope that it takes.
        browser
            .until_it_says("With this key you cannot add robots: that takes the scope upload.")
            .await;
        assert_eq!(browser.accessibility().await, Vec::<String>::new());
    });
}

#[test]
fn links_and_new_tabs_are_signed_in_until_somebody_signs_out() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 14", "ER20-0134");
    let job = plant.identified(&robot, "first_noisy.csv");
    let key = plant.key(&["read"]);
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.until_it_says("result to review").await;
        let stored = browser
            .run("return [document.cookie, JSON.stringify(sessionStorage) + JSON.stringify(localStorage)]")
            .await;
        assert_eq!(stored[0], "", "no script reads the session");
        assert!(
            !stored[1].as_str().unwrap().contains(&key),
            "no script reads the key"
        );
        browser.new_tab().await;
        browser
            .go(&format!(
                "/v1/jobs/{}/report.html",
                job["id"].as_str().unwrap()
            ))
            .await;
        browser
            .until_it_says("Position errors before and after")
            .await;
        browser.go(&format!("/#/robots/{robot}")).await;
        browser.until_it_says("Cell 14").await;
        browser.button("Sign out").await.click().await.unwrap();
        browser.until_it_says("API key").await;
        let status = browser
            .run("return fetch('/v1/me').then((answer) => answer.status)")
            .await;
        assert_eq!(status, 401, "the browser forgot the session");
    });
}
