//! A robot's log and an instrument's export: what the page asks, shows and gives back of them.

use crate::browser::{Browser, Driver, Look};
use crate::plant::{Plant, data, job_page};
use crate::{in_browser, sign_in};
use std::path::Path;

/// The paper's first set as a log and an export, each with the first of these columns in front; `name` is that of a row in both files.
fn files(plant: &Plant, columns: [&str; 2], name: impl Fn(usize) -> [String; 2]) -> [String; 2] {
    let text = std::fs::read_to_string(data("first_noisy.csv")).unwrap();
    let mut log = format!(
        "{},J1 [deg],J2 [deg],J3 [deg],J4 [deg],J5 [deg],J6 [deg]\n",
        columns[0]
    );
    let mut export = format!("{},X [mm],Y [mm],Z [mm]\n", columns[1]);
    for (row, line) in text.lines().skip(1).enumerate() {
        let cells: Vec<&str> = line.split(',').collect();
        let [ours, theirs] = name(row);
        log += &format!("{ours},{}\n", cells[2..8].join(","));
        // the instrument missed the last poses
        if row < 95 {
            export += &format!("{theirs},{}\n", cells[8..11].join(","));
        }
    }
    [("log.csv", log), ("export.csv", export)]
        .map(|(name, text)| plant.file(name, &text).to_str().unwrap().to_owned())
}

async fn give_both(browser: &Browser, robot: &str, [log, export]: &[String; 2]) {
    browser.go(&format!("/#/robots/{robot}/upload")).await;
    browser.until("document.querySelector('#set-file')").await;
    let input = browser.find("#set-file").await;
    input.send_keys(format!("{log}\n{export}")).await.unwrap();
    browser.until_it_says("Which of the two").await;
    browser.button("log.csv").await.click().await.unwrap();
}

/// Text of the download of a button.
async fn downloaded(browser: &Browser, button: &str, file: &Path) -> String {
    browser.download_to(file.parent().unwrap()).await;
    let button = format!("document.querySelector('[aria-label=\"{button}\"]')");
    browser.until(&button).await;
    browser.run(&format!("{button}.click()")).await;
    browser.until_there_is(file).await;
    std::fs::read_to_string(file).unwrap()
}

#[test]
fn files_that_are_joined_by_time_have_their_poses_their_table_and_a_remark_the_second_time() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 31", "ER20-0151");
    let key = plant.key(&["read", "upload", "identify"]);
    let times = ["Time [s]", "Time [s]"];
    let both = files(&plant, times, |row| {
        [format!("{}", 10 * row), format!("{}", 1000 + 10 * row)]
    });
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        // the clocks are asked for where the times leave their difference open
        let give_with_clock = async || {
            give_both(browser, &robot, &both).await;
            browser.until_it_says("Say once what the columns are").await;
            browser
                .until("!document.querySelector('#columns-clock').closest('div').hidden")
                .await;
            let clock = browser.find("#columns-clock").await;
            clock.send_keys("-1000").await.unwrap();
            browser
                .run("document.querySelector('#columns-keep').click()")
                .await;
            browser.button("Read it so").await.click().await.unwrap();
        };
        give_with_clock().await;
        browser
            .until_it_says("95 points in 95 configurations")
            .await;
        browser.until_it_says("Are these your poses?").await;
        browser.until_it_says("\u{2212}101.84").await;
        assert!(
            !browser
                .text()
                .await
                .contains("The same file was uploaded before")
        );

        // the table of the points is what is downloaded
        let folder = std::env::temp_dir().join(format!("kincal-two-files-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let table = downloaded(browser, "Download log", &folder.join("log.csv")).await;
        assert!(
            table.starts_with("line,configuration,q1_deg,") && table.lines().count() == 96,
            "{table}"
        );
        std::fs::remove_dir_all(folder).unwrap();

        // the same two files once more
        give_with_clock().await;
        browser
            .until_it_says("The same file was uploaded before")
            .await;
        browser.assert_quiet(&[422]).await;
    });
}

#[test]
fn a_point_under_two_groups_asks_which_group_is_read() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 33", "ER20-0153");
    let key = plant.key(&["read", "upload", "identify"]);
    let [log, export] = files(&plant, ["Point", "Group,Point"], |row| {
        [format!("P{row}"), format!("Measured,P{row}")]
    });
    let measured = std::fs::read_to_string(&export).unwrap();
    let nominal = measured.lines().skip(1);
    let nominal: Vec<String> = nominal
        .map(|line| line.replace("Measured", "Nominals"))
        .collect();
    std::fs::write(&export, format!("{measured}{}", nominal.join("\n"))).unwrap();
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        give_both(browser, &robot, &[log, export]).await;
        browser
            .until_it_says("stands under several groups, and 94 other names too")
            .await;
        let groups = browser.find("#columns-groups").await;
        groups.send_keys("Measured").await.unwrap();
        browser.button("Read it so").await.click().await.unwrap();
        browser
            .until_it_says("95 points in 95 configurations")
            .await;
        browser.assert_quiet(&[422]).await;
    });
}

#[test]
fn names_that_do_not_pair_are_asked_for_on_a_phone_and_the_chosen_column_is_read() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 32", "ER20-0152");
    let key = plant.key(&["read", "upload", "identify"]);
    let letters = |row: usize| {
        format!(
            "{}{}",
            char::from(b'a' + (row % 26) as u8),
            "x".repeat(row / 26)
        )
    };
    let both = files(&plant, ["Point", "Name,Remark"], |row| {
        [format!("P{row}"), format!("{},P{row}", letters(row))]
    });
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        browser
            .look(Look {
                size: (390, 844),
                ..Look::default()
            })
            .await;
        sign_in(browser, &key).await;
        give_both(browser, &robot, &both).await;
        browser.until_it_says("Say once what the columns are").await;
        let said = browser.text().await;
        assert!(
            said.contains("The robot's file has \"P0\", \"P1\""),
            "{said}"
        );
        // the page is as wide as the screen; each table scrolls by itself, and no choice is cut
        let wide = "return [document.documentElement.scrollWidth <= innerWidth, \
             [...document.querySelectorAll('form.columns .scroll')].every((box) => box.scrollWidth > box.clientWidth && box.getBoundingClientRect().right <= innerWidth), \
             Math.min(...[...document.querySelectorAll('form.columns th select')].map((select) => select.getBoundingClientRect().width)) >= 180]";
        assert_eq!(
            browser.run(wide).await,
            serde_json::json!([true, true, true])
        );
        browser
            .run("for (const [label, means] of [['Column 1, Name', ''], ['Column 2, Remark', 'name']]) document.querySelector(`select[aria-label=\"${label}\"]`).value = means")
            .await;
        browser.button("Read it so").await.click().await.unwrap();
        browser
            .until_it_says("95 points in 95 configurations")
            .await;
        browser.until_it_says("Row 0 (P0)").await;
        browser.assert_quiet(&[422]).await;
    });
}

#[test]
fn a_choice_that_two_files_leave_open_names_its_file() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 33", "ER20-0153");
    let key = plant.key(&["read", "upload", "identify"]);
    let both = files(&plant, ["Point", "Name"], |row| {
        [format!("P{row}"), format!("P{row}")]
    });
    // both have to be asked for their units, each by its name
    for path in &both {
        let text = std::fs::read_to_string(path).unwrap();
        let text = text.replace(" [deg]", "").replace(" [mm]", "");
        std::fs::write(path, text).unwrap();
    }
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        give_both(browser, &robot, &both).await;
        browser
            .until_it_says("J5 and J6 of the robot's file have no unit")
            .await;
        browser
            .until_it_says("Y and Z of the instrument's file have no unit")
            .await;
        browser.assert_quiet(&[422]).await;
    });
}

#[test]
fn what_is_wrong_with_a_program_stands_at_its_field_and_the_keyboard_stays_near() {
    let Some(driver) = Driver::start() else {
        return;
    };
    let plant = Plant::open();
    let robot = plant.robot("Cell 34", "ER20-0154");
    let job = plant.identified(&robot, "first_noisy.csv");
    let key = plant.key(&["read", "upload", "identify"]);
    let header = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg";
    let joints = "10,-20,30,0,45,0";
    let poses =
        format!("x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg,{header}\n800,0,900,0,90,0,{joints}\n");
    let poses = plant.file("poses.csv", &poses);
    let units = plant.file("units.csv", &format!("J1,J2,J3,J4,J5,J6\n{joints}\n"));
    in_browser(&driver, &plant.server, async |browser: &Browser| {
        sign_in(browser, &key).await;
        browser.go(&format!("/#/robots/{robot}/correct")).await;
        browser
            .until("document.querySelector('#correct-file')")
            .await;
        let correct = async |file: &Path| {
            let input = browser.find("#correct-file").await;
            input.send_keys(file.to_str().unwrap()).await.unwrap();
            browser
                .run("document.querySelector('form.card button[type=submit]').click()")
                .await;
        };
        let stands_at = async |field: &str, said: &str| {
            browser.until_it_says(said).await;
            browser
                .until(&format!(
                    "document.activeElement === document.querySelector('{field}')"
                ))
                .await;
            let described = "return document.getElementById(document.activeElement.getAttribute('aria-describedby')).innerText";
            let described = browser.run(described).await;
            assert!(described.as_str().unwrap().contains(said), "{described}");
            browser
                .until("document.querySelectorAll('[aria-invalid=true]').length === 1")
                .await;
        };
        correct(&poses).await;
        stands_at("#correct-rotation", "are a rotation only with a convention").await;
        browser
            .run("document.querySelector('[aria-label=\"Tool x, mm\"]').value = 3")
            .await;
        correct(&poses).await;
        stands_at("[aria-label=\"Tool y, mm\"]", "Tool y, mm is empty").await;
        browser
            .run("document.querySelector('[aria-label=\"Tool x, mm\"]').value = ''")
            .await;
        correct(&units).await;
        stands_at("#correct-file", "In which unit are the joint values?").await;
        assert_eq!(browser.accessibility().await, Vec::<String>::new());
        browser.button("Degrees").await.click().await.unwrap();
        browser.until_it_says("Corrected targets").await;
        browser
            .until("document.activeElement.innerText.includes('Corrected targets')")
            .await;
        browser
            .until("!document.querySelector('[aria-invalid]')")
            .await;

        // in the panel of a point the keyboard stays where it was
        browser.go(&job_page(&job)).await;
        browser.select_first_point().await;
        for (press, then) in [
            ("Leave it out …", "Keep it"),
            ("Keep it", "Leave it out …"),
            ("Next", "Next"),
        ] {
            browser
                .run(&format!("const button = [...document.querySelectorAll('.picked button')].find((b) => b.innerText === '{press}'); button.focus(); button.click()"))
                .await;
            browser
                .until(&format!("document.activeElement.innerText === '{then}'"))
                .await;
        }
        browser.assert_quiet(&[422]).await;
    });
}
