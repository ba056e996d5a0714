//! The closed loop: a robot with errors is measured from an instrument, identified, and moved with corrected targets.

use crate::app::{TestApp, paper, text};
use crate::real_robot::{RealRobot, apply, rigid, shift, times, turn};
use crate::simulation::Normal;
use serde_json::{Value, json};

pub const LIMITS_DEG: [f64; 6] = [150.0, 55.0, 60.0, 160.0, 100.0, 170.0];
pub const NOISE_MM: f64 = 0.03;

/// The paper's table, mm and rad: a, alpha, d, theta, beta.
pub fn nominal(robot: &Value) -> Vec<[f64; 5]> {
    let number = |link: &Value, name: &str| link[name].as_f64().unwrap();
    let links = robot["links"].as_array().unwrap().iter();
    links
        .map(|l| {
            [
                number(l, "a_mm"),
                number(l, "alpha_deg").to_radians(),
                number(l, "d_mm"),
                number(l, "theta_offset_deg").to_radians(),
                0.0,
            ]
        })
        .collect()
}

/// The robot with errors of 0.3 mm and 0.05° in every link between the first and the last, sag of joints 2 and 3, and eccentric transmissions.
pub fn real_robot(nominal: &[[f64; 5]], random: &mut Normal) -> RealRobot {
    let mut links = nominal.to_vec();
    for (i, link) in links.iter_mut().enumerate().skip(1) {
        link[0] += 0.3 * random.draw();
        link[1] += 0.05f64.to_radians() * random.draw();
        if i < 5 {
            link[2] += 0.3 * random.draw();
            link[3] += 0.05f64.to_radians() * random.draw();
        }
    }
    links[2][4] = 0.05f64.to_radians() * random.draw();
    let mut eccentric_rad = vec![[0.0; 4]; 6];
    eccentric_rad[1] = [8e-5, -5e-5, 4e-5, 0.0];
    eccentric_rad[2] = [-6e-5, 7e-5, 0.0, 3e-5];
    eccentric_rad[3] = [1e-4, 0.0, 0.0, -5e-5];
    let place = times(
        &shift([1800.0, -700.0, 400.0]),
        &times(&turn(2, 2.1), &turn(0, 0.2)),
    );
    RealRobot {
        links,
        give_rad: vec![0.0, 4e-4, 5e-4, 0.0, 0.0, 0.0],
        masses: vec![0.0, 0.0, 1.0, 0.0, 1.0, 0.5],
        eccentric_rad,
        target_mm: [85.0, -20.0, 110.0],
        t_instrument_base: place,
    }
}

/// The robot in its cell, and its resources on the server.
pub struct Cell {
    /// Its path on the server.
    pub robot: String,
    nominal: Vec<[f64; 5]>,
    pub truth: RealRobot,
    pub random: Normal,
}

impl Cell {
    pub async fn registered(app: &TestApp) -> Self {
        let body = arm();
        let nominal = nominal(&body);
        let mut random = Normal::new(77);
        let truth = real_robot(&nominal, &mut random);
        let robot = app.post_json("/v1/robots", &body).await.ok(201);
        Self {
            robot: format!("/v1/robots/{}", text(&robot["id"])),
            nominal,
            truth,
            random,
        }
    }
}

/// The instrument's measurements at these poses.
pub fn csv(truth: &RealRobot, poses_rad: &[Vec<f64>], random: &mut Normal) -> String {
    let mut csv = String::from("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n");
    for q in poses_rad {
        let seen = truth.seen(q).map(|mm| mm + NOISE_MM * random.draw());
        let cells: Vec<String> = q
            .iter()
            .map(|q| q.to_degrees().to_string())
            .chain(seen.iter().map(f64::to_string))
            .collect();
        csv += &(cells.join(",") + "\n");
    }
    csv
}

pub fn rms(errors: &[f64]) -> f64 {
    (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt()
}

pub fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

/// The paper's arm on a floor, with joint limits.
pub fn arm() -> Value {
    let mut body: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    body["mounting"] = json!("floor");
    for (link, limit) in body["links"]
        .as_array_mut()
        .unwrap()
        .iter_mut()
        .zip(LIMITS_DEG)
    {
        link["joint_limits_deg"] = json!([-limit - 20.0, limit + 20.0]);
    }
    body
}

/// A robot measured from its instrument at random poses, with noise.
pub fn campaign(truth: &RealRobot, n: usize, random: &mut Normal) -> String {
    let poses: Vec<Vec<f64>> = (0..n).map(|_| random.pose(&LIMITS_DEG)).collect();
    csv(truth, &poses, random)
}

#[tokio::test]
async fn a_real_robot_lands_where_the_nominal_one_would() {
    let app = TestApp::with_workers(1).await;
    let Cell {
        robot,
        nominal,
        truth,
        mut random,
    } = Cell::registered(&app).await;
    let poses: Vec<Vec<f64>> = (0..150).map(|_| random.pose(&LIMITS_DEG)).collect();
    let csv = csv(&truth, &poses, &mut random);
    let set = app.upload_csv(&robot, "frame=instrument", csv).await;
    let job = app.run(&robot, &json!({"measurement_set_id": set["id"], "verify": {"source": "fraction", "fraction": 0.1}})).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let report = app.report(&job).await;
    println!(
        "verify {}; corrections {}",
        report["verify"], report["corrections"]
    );

    // targets that were programmed offline, away from the wrist's singularity
    let programmed: Vec<Vec<f64>> = std::iter::repeat_with(|| random.pose(&LIMITS_DEG))
        .filter(|q| q[4].abs() > 0.15)
        .take(200)
        .collect();
    let q_deg: Vec<Vec<f64>> = programmed
        .iter()
        .map(|q| q.iter().map(|q| q.to_degrees()).collect())
        .collect();
    for mode in ["pose", "position"] {
        let path = format!(
            "/v1/parameter-sets/{}/compensate",
            text(&job["parameter_set_id"])
        );
        let answer = app
            .post_json(&path, &json!({"q_deg": q_deg, "mode": mode}))
            .await
            .ok(200);
        let corrected: Vec<Vec<f64>> = serde_json::from_value(answer["q_deg"].clone()).unwrap();
        let (mut before, mut after, mut all) = (Vec::new(), Vec::new(), Vec::new());
        for ((came, corrected), status) in programmed
            .iter()
            .zip(&corrected)
            .zip(answer["status"].as_array().unwrap())
        {
            let flange = nominal
                .iter()
                .zip(came)
                .fold(shift([0.0; 3]), |t, (link, q)| times(&t, &rigid(link, *q)));
            let wanted = apply(&flange, truth.target_mm);
            let commanded: Vec<f64> = corrected.iter().map(|q| q.to_radians()).collect();
            let missed = distance(truth.in_base(&commanded), wanted);
            all.push(missed);
            if status == "ok" {
                before.push(distance(truth.in_base(came), wanted));
                after.push(missed);
            }
        }
        let extrapolated = answer["extrapolated"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|e| **e == json!(true))
            .count();
        let worst = all.iter().fold(0.0, |m: f64, e| m.max(*e));
        println!(
            "{mode}: {} of 200 ok: {:.4} mm rms before, {:.4} mm after; all 200: {:.4} mm rms, {worst:.4} mm at most; {extrapolated} extrapolated",
            after.len(),
            rms(&before),
            rms(&after),
            rms(&all)
        );
        assert!(after.len() >= 190, "{}", answer["status"]);
        assert!(rms(&before) > 1.0);
        assert!(rms(&after) < 0.05, "{mode}: {}", rms(&after));
    }
}
