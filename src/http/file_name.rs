//! Names of downloaded files: the robot, the day on which its points were measured, and the item.

use crate::http::{App, Error};
use crate::release;
use crate::store::{jobs, measurement_sets, robots};
use crate::wire::time::rfc3339;
use axum::http::HeaderValue;

/// Maximum length of the robot's name in a file name, characters.
const MAX_NAME: usize = 60;
/// Length of a date, `2026-03-01`.
const DATE: usize = 10;

/// `Content-Disposition` of a file about a job's result: `ER20-7_2026-03-01_ps_0123.urdf`.
pub async fn attachment(
    app: &App,
    robot_id: &str,
    job_id: &str,
    id: &str,
    extension: &str,
) -> Result<HeaderValue, Error> {
    let robot = robots::get(&app.store, robot_id).await?;
    let job = jobs::get(&app.store, job_id).await?;
    let set = measurement_sets::get(&app.store, &job.measurement_set_id).await?;
    let at_ms = release::measured_at_ms(set.reading_json.as_deref(), set.created_at_ms);
    let name = file_name(&robot.name, &rfc3339(at_ms), id);
    HeaderValue::from_str(&format!("attachment; filename=\"{name}.{extension}\""))
        .map_err(|error| Error::Internal(error.to_string()))
}

fn file_name(robot: &str, measured_at: &str, id: &str) -> String {
    let day = measured_at.get(..DATE).unwrap_or_default();
    let parts = [&*safe(robot), day, id];
    let parts: Vec<&str> = parts.into_iter().filter(|part| !part.is_empty()).collect();
    parts.join("_")
}

/// The ASCII letters, digits, dots and hyphens of a name, with `-` for the characters between them, so that every file system takes it.
fn safe(name: &str) -> String {
    let is_kept = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-');
    let words = name.split(|c| !is_kept(c)).filter(|word| !word.is_empty());
    let whole = words.collect::<Vec<_>>().join("-");
    let whole: String = whole.chars().take(MAX_NAME).collect();
    whole.trim_matches(['.', '-']).to_owned()
}

#[cfg(test)]
mod tests {
    use super::file_name;

    #[test]
    fn a_file_is_called_after_robot_and_day_in_characters_that_every_file_system_takes() {
        let at = "2026-03-01T07:15:30.000Z";
        for (robot, name) in [
            ("ER20-C10", "ER20-C10_2026-03-01_ps_1"),
            ("Cell 7 / \"left\"\r\n", "Cell-7-left_2026-03-01_ps_1"),
            ("../../etc", "etc_2026-03-01_ps_1"),
            ("机器人", "2026-03-01_ps_1"),
            ("Zelle ä", "Zelle_2026-03-01_ps_1"),
        ] {
            assert_eq!(file_name(robot, at, "ps_1"), name);
        }
        assert!(file_name(&"x".repeat(500), at, "ps_1").len() < 100);
    }
}
