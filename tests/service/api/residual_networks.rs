//! The residual network of a robot: storage, lists, and the start of the next network's training.

use crate::api::closed_loop::{LIMITS_DEG, NOISE_MM, arm, nominal, real_robot};
use crate::app::{TestApp, text};
use crate::real_robot::RealRobot;
use crate::simulation::Normal;
use serde_json::{Value, json};

/// An error that links, gravity and harmonics of single joints cannot describe: it depends on sums of joints.
fn drift_mm(q: &[f64]) -> [f64; 3] {
    [
        0.35 * (q[0] + q[1]).sin(),
        0.3 * (q[1] - q[2]).cos(),
        0.3 * (q[0] - q[2]).sin(),
    ]
}

/// A session at random poses, in the base frame.
fn session(truth: &RealRobot, drifts: bool, n: usize, random: &mut Normal) -> String {
    let mut csv = String::from("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n");
    for _ in 0..n {
        let q = random.pose(&LIMITS_DEG);
        let (rigid, off) = (
            truth.in_base(&q),
            if drifts { drift_mm(&q) } else { [0.0; 3] },
        );
        let seen = (0..3).map(|k| rigid[k] + off[k] + NOISE_MM * random.draw());
        let cells: Vec<String> = q
            .iter()
            .map(|q| q.to_degrees())
            .chain(seen)
            .map(|v| v.to_string())
            .collect();
        csv += &(cells.join(",") + "\n");
    }
    csv
}

async fn robot(app: &TestApp) -> String {
    format!(
        "/v1/robots/{}",
        text(&app.post_json("/v1/robots", &arm()).await.ok(201)["id"])
    )
}

async fn upload(app: &TestApp, robot: &str, csv: &str) -> Value {
    let path = format!("{robot}/measurement-sets?frame=instrument");
    app.post(&path, "text/csv", csv.to_owned()).await.ok(201)["id"].clone()
}

/// Runs a job. Returns it, and the report's text about the network.
async fn identified(app: &TestApp, robot: &str, set: &Value) -> (Value, Value) {
    let request =
        json!({"measurement_set_id": set, "verify": {"source": "fraction", "fraction": 0.1}});
    let job = app.run(robot, &request).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let report = app.report(&job).await;
    let tried = report["corrections"]
        .as_array()
        .unwrap()
        .iter()
        .find(|c| c["kind"] == "residual_network");
    (job, tried.cloned().unwrap_or_default())
}

async fn networks(app: &TestApp, robot: &str) -> Vec<Value> {
    app.get(&format!("{robot}/networks")).await.ok(200)["items"]
        .as_array()
        .unwrap()
        .clone()
}

/// A tensor of a safetensors file, read by hand: eight bytes of length, a JSON header, the data.
fn tensor(file: &[u8], name: &str) -> Vec<f64> {
    let n = u64::from_le_bytes(file[..8].try_into().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&file[8..8 + n]).unwrap();
    let at = |i: usize| 8 + n + header[name]["data_offsets"][i].as_u64().unwrap() as usize;
    assert_eq!(header[name]["dtype"], "F64");
    file[at(0)..at(1)]
        .chunks(8)
        .map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap()))
        .collect()
}

/// Errors of five robots at points that were left out of the fit: the follow-up that continues from the last network, against a robot that starts anew with
/// the same points. A single robot may have the opposite by chance.
#[tokio::test]
async fn a_network_that_continues_from_the_last_one_is_better_than_one_from_random_weights() {
    let app = TestApp::with_workers(1).await;
    let mut ratios = Vec::new();
    for seed in 5..10 {
        let mut random = Normal::new(seed);
        let truth = real_robot(&nominal(&arm()), &mut random);
        let first_csv = session(&truth, true, 120, &mut random);
        let second_csv = session(&truth, true, 120, &mut random);
        let (cell, other) = (robot(&app).await, robot(&app).await);
        let first_set = upload(&app, &cell, &first_csv).await;
        identified(&app, &cell, &first_set).await;
        let mut rms_mm = Vec::new();
        for path in [&cell, &other] {
            let set = upload(&app, path, &second_csv).await;
            let (_, network) = identified(&app, path, &set).await;
            assert_eq!(network["kept"], true, "seed {seed}: {network}");
            rms_mm.push(network["cross_validated_rms_mm_after"].as_f64().unwrap());
        }
        println!(
            "seed {seed}: {:.4} mm cross-validated from the last network, {:.4} mm from random weights",
            rms_mm[0], rms_mm[1]
        );
        ratios.push(rms_mm[0] / rms_mm[1]);
    }
    ratios.sort_by(f64::total_cmp);
    assert!(ratios[2] < 1.0, "{ratios:?}");
}

#[tokio::test]
async fn a_residual_network_is_stored_like_the_papers_and_the_next_one_goes_on_from_it() {
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(5);
    let truth = real_robot(&nominal(&arm()), &mut random);
    let (first_csv, second_csv) = (
        session(&truth, true, 120, &mut random),
        session(&truth, true, 120, &mut random),
    );
    let cell = robot(&app).await;
    let first_set = upload(&app, &cell, &first_csv).await;
    let (first, tried) = identified(&app, &cell, &first_set).await;
    println!("first session: {tried}");
    assert_eq!(tried["kept"], true, "{tried}");
    assert!(
        first.get("residual_network_from").is_none(),
        "there was none before: {first}"
    );

    // Listed, described and fetched, it has the same numbers as in the parameter set.
    let stored = networks(&app, &cell).await;
    assert_eq!(stored.len(), 1);
    assert_eq!(
        (&stored[0]["id"], &stored[0]["job_id"]),
        (&first["residual_network_id"], &first["id"])
    );
    assert_eq!(
        (&stored[0]["kind"], &stored[0]["parameter_names"][5]),
        (&json!("residual"), &json!("q_6"))
    );
    let after = tried["cross_validated_rms_mm_after"].as_f64().unwrap();
    assert!((stored[0]["validation_error"].as_f64().unwrap() - after * after).abs() < 1e-12);
    let path = format!("/v1/networks/{}", text(&stored[0]["id"]));
    assert_eq!(app.get(&path).await.ok(200), stored[0]);
    let weights = app.get(&format!("{path}/weights")).await.bytes;
    let set = app.parameter_set(&first).await;
    let used = &set["corrections"]["residual_network"];
    for name in [
        "hidden_weights",
        "hidden_thresholds",
        "output_weights",
        "output_thresholds",
    ] {
        assert_eq!(json!(tensor(&weights, name)), used[name], "{name}");
    }
    assert_eq!(
        json!(tensor(&weights, "scale_mm")),
        json!([used["scale_mm"]])
    );
    for (rad, deg) in tensor(&weights, "centre_rad")
        .iter()
        .zip(used["centre_deg"].as_array().unwrap())
    {
        assert!((rad.to_degrees() - deg.as_f64().unwrap()).abs() < 1e-12);
    }

    // The follow-up continues from it; a robot that starts anew with the same points has no network to continue from.
    let second_set = upload(&app, &cell, &second_csv).await;
    let (second, _) = identified(&app, &cell, &second_set).await;
    assert_eq!(
        second["residual_network_from"],
        first["residual_network_id"]
    );
    assert_ne!(second["residual_network_id"], first["residual_network_id"]);
    assert_eq!(networks(&app, &cell).await.len(), 2);
    let other = robot(&app).await;
    let alone = upload(&app, &other, &second_csv).await;
    let (begun_anew, _) = identified(&app, &other, &alone).await;
    assert!(begun_anew.get("residual_network_from").is_none());

    // A network that has seen the points would make its own cross-validation worthless.
    let same_again = upload(&app, &other, &(second_csv.clone() + "\n")).await;
    let request = json!({"measurement_set_id": same_again, "residual_network_id": begun_anew["residual_network_id"]});
    let refused = app
        .post_json(&format!("{other}/jobs"), &request)
        .await
        .problem(409, "network_mismatch");
    assert!(
        text(&refused["detail"]).contains("has seen points of these sets"),
        "{refused}"
    );
    let posted = app
        .post_json(
            &format!("{other}/jobs"),
            &json!({"measurement_set_id": same_again}),
        )
        .await
        .ok(202);
    assert!(posted.get("residual_network_from").is_none(), "{posted}");
    // The same holds for a network that continues such a network, and for one that has seen the verify points.
    let verify = json!({"source": "set", "measurement_set_id": first_set});
    for request in [
        json!({"measurement_set_id": first_set, "seed": 1}),
        json!({"measurement_set_id": second_set, "verify": verify}),
    ] {
        let posted = app
            .post_json(&format!("{cell}/jobs"), &request)
            .await
            .ok(202);
        assert!(
            posted.get("residual_network_from").is_none(),
            "{request}: {posted}"
        );
    }

    // Options that exclude each other are refused when the job is posted.
    let jobs = format!("{cell}/jobs");
    let network_id = &first["residual_network_id"];
    for (request, code, pointer) in [
        (
            json!({"measurement_set_id": second_set, "method": "bpnn_pso", "network_id": network_id}),
            "unknown_reference",
            "/network_id",
        ),
        (
            json!({"measurement_set_id": second_set, "residual_network_id": begun_anew["residual_network_id"]}),
            "unknown_reference",
            "/residual_network_id",
        ),
        (
            json!({"measurement_set_id": second_set, "residual_network_id": network_id, "corrections": "off"}),
            "invalid_job",
            "/residual_network_id",
        ),
    ] {
        let problem = app.post_json(&jobs, &request).await.problem(422, code);
        assert_eq!(problem["errors"][0]["pointer"], pointer, "{problem}");
    }
}

#[tokio::test]
async fn where_links_say_everything_no_residual_network_is_kept() {
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(6);
    let stiff = RealRobot {
        give_rad: vec![0.0; 6],
        eccentric_rad: vec![[0.0; 4]; 6],
        ..real_robot(&nominal(&arm()), &mut random)
    };
    let cell = robot(&app).await;
    let set = upload(&app, &cell, &session(&stiff, false, 60, &mut random)).await;
    let (job, tried) = identified(&app, &cell, &set).await;
    println!("a robot of links alone: {tried}");
    assert!(tried.is_null() || tried["kept"] == false, "{tried}");
    assert!(job.get("residual_network_id").is_none(), "{job}");
    assert!(networks(&app, &cell).await.is_empty());
}
