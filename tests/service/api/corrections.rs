//! Corrections from a job to a prediction: a simulated robot that sags, measured with ten kilograms on its flange.

use crate::api::closed_loop::{LIMITS_DEG, arm, campaign, distance, nominal, real_robot, rms};
use crate::app::{TestApp, text};
use crate::real_robot::{RealRobot, apply, rigid, shift, times};
use crate::simulation::Normal;
use serde_json::{Value, json};

/// Default of `mass_unit_kg`.
const KG_PER_UNIT: f64 = 10.0;
const MEASURED_WITH_KG: f64 = 10.0;

/// The robot with this mass at the origin of its flange.
fn with_payload(truth: &RealRobot, kg: f64) -> RealRobot {
    let mut loaded = truth.clone();
    loaded.masses[5] += kg / KG_PER_UNIT;
    loaded
}

fn payload(kg: f64) -> Value {
    json!({"mass_kg": kg, "centre_mm": [0, 0, 0]})
}

struct Measured {
    app: TestApp,
    robot: String,
    set: Value,
    truth: RealRobot,
    unseen: Vec<Vec<f64>>,
}

/// 120 poses to measure, and 100 others to predict.
async fn measured(seed: u64) -> Measured {
    let app = TestApp::with_workers(1).await;
    let body = arm();
    let mut random = Normal::new(seed);
    let truth = real_robot(&nominal(&body), &mut random);
    let robot = format!(
        "/v1/robots/{}",
        text(&app.post_json("/v1/robots", &body).await.ok(201)["id"])
    );
    let csv = campaign(&with_payload(&truth, MEASURED_WITH_KG), 120, &mut random);
    let set = app.upload_csv(&robot, "frame=instrument", csv).await;
    let unseen = (0..100).map(|_| random.pose(&LIMITS_DEG)).collect();
    Measured {
        app,
        robot,
        set,
        truth,
        unseen,
    }
}

impl Measured {
    /// Report and path of the parameter set of a job with these extra fields.
    async fn identify(&self, extra: Value) -> (Value, String) {
        let mut request = json!({"measurement_set_id": self.set["id"], "verify": {"source": "fraction", "fraction": 0.2}});
        extra
            .as_object()
            .unwrap()
            .iter()
            .for_each(|(name, value)| request[name] = value.clone());
        let job = self.app.run(&self.robot, &request).await;
        assert_eq!(job["status"], "succeeded", "{job}");
        let report = self.app.report(&job).await;
        (
            report,
            format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"])),
        )
    }

    fn q_deg(&self) -> Vec<Vec<f64>> {
        self.unseen
            .iter()
            .map(|q| q.iter().map(|q| q.to_degrees()).collect())
            .collect()
    }

    /// Prediction error against the true robot with this payload, rms, mm.
    async fn prediction_error(&self, set: &str, extra: Value, kg: f64) -> f64 {
        let mut body = extra;
        body["q_deg"] = json!(self.q_deg());
        let answer = self
            .app
            .post_json(&format!("{set}/predict"), &body)
            .await
            .ok(200);
        let found: Vec<[f64; 3]> = serde_json::from_value(answer["position_mm"].clone()).unwrap();
        let truth = with_payload(&self.truth, kg);
        rms(&found
            .iter()
            .zip(&self.unseen)
            .map(|(p, q)| distance(*p, truth.seen(q)))
            .collect::<Vec<f64>>())
    }
}

fn number(value: &Value) -> f64 {
    value
        .as_f64()
        .unwrap_or_else(|| panic!("not a number: {value}"))
}

#[tokio::test]
async fn corrections_come_with_their_evidence_and_stand_apart_from_the_links() {
    let cell = measured(41).await;
    let (report, set) = cell
        .identify(json!({"payload": payload(MEASURED_WITH_KG)}))
        .await;
    let tried = report["corrections"].as_array().unwrap();
    let kinds: Vec<&str> = tried.iter().map(|c| text(&c["kind"])).collect();
    let physical = [
        "compliance",
        "joint_coupling",
        "link_masses",
        "joint_harmonics",
    ];
    assert_eq!(kinds[..4], physical, "{kinds:?}");
    for c in tried {
        let (gain, error) = (number(&c["gain_mm2"]), number(&c["standard_error_mm2"]));
        assert_eq!(c["kept"], gain > 2.0 * error, "{c}");
        assert_eq!(
            gain > 0.0,
            number(&c["cross_validated_rms_mm_after"])
                < number(&c["cross_validated_rms_mm_before"]),
            "{c}"
        );
    }
    assert_eq!(tried[0]["kept"], true, "{}", tried[0]);
    println!(
        "verify {}; tried {}",
        report["verify"], report["corrections"]
    );
    let of = |stage: &str| number(&report["verify"][stage]["rms_mm"]);
    assert!(
        of("corrected") < 0.1 && of("after") > 3.0 * of("corrected") && of("before") > of("after"),
        "{}",
        report["verify"]
    );
    // The errors of all points are those of the two halves.
    for half in ["identify", "verify"] {
        let points = report["per_point"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|p| p["subset"] == half);
        let corrected: Vec<f64> = points.map(|p| number(&p["corrected_mm"])).collect();
        assert!(
            (rms(&corrected) - number(&report[half]["corrected"]["rms_mm"])).abs() < 1e-9,
            "{half}"
        );
    }
    for point in report["per_point"].as_array().unwrap() {
        let vector: [f64; 3] =
            serde_json::from_value(point["corrected_vector_mm"].clone()).unwrap();
        assert!(
            (distance(vector, [0.0; 3]) - number(&point["corrected_mm"])).abs() < 1e-12,
            "{point}"
        );
    }

    let document = cell.app.get(&set).await.ok(200);
    assert_eq!(
        document["links_with_corrections"].as_array().unwrap().len(),
        6
    );
    assert_ne!(document["links_with_corrections"], document["links"]);
    let corrections = &document["corrections"];
    assert_eq!(
        (&corrections["version"], &corrections["payload"]["mass_kg"]),
        (&json!(2), &json!(10.0))
    );
    // 4e-4 and 5e-4 rad per unit about the axes of joints 2 and 3
    for (joint, rad) in [(1, 4e-4), (2, 5e-4)] {
        let found = number(&corrections["joint_compliance_deg"][joint][2]).to_radians();
        assert!(
            (found - rad).abs() < 0.25 * rad,
            "joint {}: {found} rad, truly {rad}",
            joint + 1
        );
    }

    // Predictions are as uncertain as links and corrections are, not as the links alone.
    let in_degrees = |q: &Vec<f64>| q.iter().map(|rad| rad.to_degrees()).collect();
    let poses: Vec<Vec<f64>> = cell.unseen.iter().map(in_degrees).collect();
    let predicted = cell
        .app
        .post(
            &format!("{set}/predict"),
            "application/json",
            json!({"q_deg": poses}).to_string(),
        )
        .await
        .ok(200);
    let std_mm: Vec<f64> = serde_json::from_value(predicted["position_std_mm"].clone()).unwrap();
    let [links_mm, corrected_mm] = ["tool_uncertainty_mm", "tool_uncertainty_corrected_mm"]
        .map(|of| number(&report[of]["mean"]));
    assert!(
        3.0 * corrected_mm < links_mm && rms(&std_mm) < 0.5 * links_mm,
        "{std_mm:?}, {corrected_mm} of {links_mm}"
    );

    // With corrections off: the same links, and nothing else.
    let (plain, plain_set) = cell.identify(json!({"corrections": "off"})).await;
    let links_alone = cell.app.get(&plain_set).await.ok(200);
    assert_eq!(links_alone["links"], document["links"]);
    assert!(
        links_alone.get("corrections").is_none()
            && links_alone.get("links_with_corrections").is_none()
    );
    assert!(plain.get("corrections").is_none() && plain["verify"].get("corrected").is_none());
    assert!(
        plain["per_point"]
            .as_array()
            .unwrap()
            .iter()
            .all(|p| p.get("corrected_mm").is_none() && p.get("corrected_vector_mm").is_none())
    );
    assert_eq!(plain["verify"]["after"], report["verify"]["after"]);

    // Predictions use corrections where the robot was measured.
    let (with, without) = (
        cell.prediction_error(&set, json!({}), MEASURED_WITH_KG)
            .await,
        cell.prediction_error(&plain_set, json!({}), MEASURED_WITH_KG)
            .await,
    );
    println!("unseen poses: {with:.4} mm rms with corrections, {without:.4} mm by the links alone");
    assert!(with < 0.06 && without > 0.3, "{with} {without}");
    let predict = async |set: &str, q_deg: &Value| {
        cell.app
            .post_json(&format!("{set}/predict"), &json!({"q_deg": q_deg}))
            .await
            .ok(200)
    };
    let inside = json!([[0.0, 20.0, -10.0, 30.0, 40.0, 10.0]]);
    assert_eq!(predict(&set, &inside).await["extrapolated"], json!([false]));
    assert_ne!(
        predict(&set, &inside).await["position_mm"],
        predict(&plain_set, &inside).await["position_mm"]
    );
    // Joint 2 was measured between -55 and 55 degrees. Twice as far out only the links predict.
    let outside = json!([[0.0, 115.0, -10.0, 30.0, 40.0, 10.0]]);
    assert_eq!(predict(&set, &outside).await["extrapolated"], json!([true]));
    assert_eq!(
        predict(&set, &outside).await["position_mm"],
        predict(&plain_set, &outside).await["position_mm"]
    );
    assert_eq!(
        predict(&plain_set, &outside).await["extrapolated"],
        json!([false]),
        "nothing fades where there is nothing"
    );
}

/// Predicted positions with a payload.
async fn predicted(cell: &Measured, set: &str, payload: Option<Value>) -> Vec<[f64; 3]> {
    let mut body = json!({"q_deg": cell.q_deg()});
    payload
        .into_iter()
        .for_each(|payload| body["payload"] = payload);
    let answer = cell
        .app
        .post_json(&format!("{set}/predict"), &body)
        .await
        .ok(200);
    serde_json::from_value(answer["position_mm"].clone()).unwrap()
}

fn between(a: &[[f64; 3]], b: &[[f64; 3]]) -> Vec<f64> {
    a.iter()
        .zip(b)
        .flat_map(|(a, b)| (0..3).map(|k| a[k] - b[k]))
        .collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Cosine between two displacements, and the share of the second in the first.
fn direction_and_share(found: &[f64], truth: &[f64]) -> (f64, f64) {
    (
        dot(found, truth) / (dot(found, found) * dot(truth, truth)).sqrt(),
        dot(found, truth) / dot(truth, truth),
    )
}

#[tokio::test]
async fn another_payload_moves_predictions_and_corrected_targets_the_way_it_moves_the_robot() {
    let cell = measured(42).await;
    let (_, set) = cell
        .identify(json!({"payload": payload(MEASURED_WITH_KG)}))
        .await;
    let as_measured = predicted(&cell, &set, None).await;
    assert_eq!(
        predicted(&cell, &set, Some(payload(MEASURED_WITH_KG))).await,
        as_measured
    );
    let truly = |kg: f64| {
        cell.unseen
            .iter()
            .map(|q| with_payload(&cell.truth, kg).seen(q))
            .collect::<Vec<_>>()
    };
    for kg in [0.0, 25.0] {
        let moved = between(
            &predicted(&cell, &set, Some(payload(kg))).await,
            &as_measured,
        );
        let (cosine, share) =
            direction_and_share(&moved, &between(&truly(kg), &truly(MEASURED_WITH_KG)));
        println!("{kg} kg: cosine with the true displacement {cosine:.4}, share of it {share:.3}");
        // The direction follows from physics. The size depends on the masses of the links, which one payload does not determine (docs/corrections.md):
        // to a factor of two.
        assert!(
            cosine > 0.95 && (0.5..2.0).contains(&share),
            "{kg} kg: {cosine} {share}"
        );
        let (with_its_payload, without_payload) = (
            cell.prediction_error(&set, json!({"payload": payload(kg)}), kg)
                .await,
            cell.prediction_error(&set, json!({}), kg).await,
        );
        println!(
            "{kg} kg: {with_its_payload:.4} mm rms when the prediction is told, {without_payload:.4} mm when it is not"
        );
        assert!(
            with_its_payload < without_payload,
            "{kg} kg: {with_its_payload} {without_payload}"
        );
    }
    // Twice the moment gives twice the rotation.
    let half = between(
        &predicted(&cell, &set, Some(payload(15.0))).await,
        &as_measured,
    );
    let whole = between(
        &predicted(&cell, &set, Some(payload(20.0))).await,
        &as_measured,
    );
    assert!(
        (direction_and_share(&whole, &half).1 - 2.0).abs() < 1e-2,
        "{}",
        direction_and_share(&whole, &half).1
    );

    // Corrected targets move the opposite way.
    let mut commanded = Vec::new();
    for extra in [json!({}), json!({"payload": payload(0.0)})] {
        let mut body = extra;
        (body["q_deg"], body["mode"]) = (json!(cell.q_deg()), json!("position"));
        let answer = cell
            .app
            .post_json(&format!("{set}/compensate"), &body)
            .await
            .ok(200);
        let corrected: Vec<Vec<f64>> = serde_json::from_value(answer["q_deg"].clone()).unwrap();
        commanded.push(
            corrected
                .iter()
                .map(|q| q.iter().map(|q| q.to_radians()).collect::<Vec<f64>>())
                .collect::<Vec<_>>(),
        );
    }
    let empty = with_payload(&cell.truth, 0.0);
    let nominal_links = nominal(&arm());
    let prediction_error = |commanded: &[Vec<f64>]| {
        let wanted = |q: &Vec<f64>| {
            nominal_links
                .iter()
                .zip(q)
                .fold(shift([0.0; 3]), |t, (link, q)| times(&t, &rigid(link, *q)))
        };
        let of = commanded
            .iter()
            .zip(&cell.unseen)
            .map(|(q, came)| distance(empty.in_base(q), apply(&wanted(came), empty.target_mm)));
        rms(&of.collect::<Vec<f64>>())
    };
    println!(
        "empty gripper: {:.4} mm rms when told, {:.4} mm when not",
        prediction_error(&commanded[1]),
        prediction_error(&commanded[0])
    );
    assert!(prediction_error(&commanded[1]) < prediction_error(&commanded[0]));
    let wrong = cell
        .app
        .post_json(
            &format!("{set}/predict"),
            &json!({"q_deg": [], "payload": payload(-1.0)}),
        )
        .await;
    assert_eq!(
        wrong.problem(422, "invalid_poses")["errors"][0]["pointer"],
        "/payload/mass_kg"
    );
}

#[tokio::test]
async fn beside_bounds_corrections_are_left_out_and_the_report_says_so() {
    let cell = measured(43).await;
    let bounded = json!([{"name": "a_3", "std": 0.5, "min": 780.0}]);
    let (report, set) = cell
        .identify(json!({"parameters": {"priors": bounded}}))
        .await;
    assert!(
        report.get("corrections").is_none(),
        "{}",
        report["corrections"]
    );
    let n_warnings = |report: &Value| {
        report["warnings"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|w| w["code"] == "corrections_left_out")
            .count()
    };
    assert_eq!(n_warnings(&report), 1, "{}", report["warnings"]);
    assert!(
        cell.app
            .get(&set)
            .await
            .ok(200)
            .get("corrections")
            .is_none()
    );
    let (asked_off, _) = cell
        .identify(json!({"corrections": "off", "parameters": {"priors": bounded}}))
        .await;
    assert_eq!(n_warnings(&asked_off), 0, "nobody asked for any");
    let (unbounded, _) = cell
        .identify(json!({"parameters": {"priors": [{"name": "a_3", "std": 0.5}]}}))
        .await;
    assert_eq!(n_warnings(&unbounded), 0, "{}", unbounded["warnings"]);
    assert!(unbounded.get("corrections").is_some());
}

/// Groups of neighbouring poses, each group with its own error: neighbours predict a pose well, so corrections win
/// the cross-validation, but do not hold at the verify poses.
fn misleading_groups(random: &mut Normal) -> String {
    const GROUPS: usize = 20;
    let truth = real_robot(&nominal(&arm()), random);
    let mut csv = String::from("subset,q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad,x_mm,y_mm,z_mm\n");
    for group in 0..GROUPS + 40 {
        let (middle, own_mm) = (
            random.pose(&LIMITS_DEG),
            [0; 3].map(|_| 0.3 * random.draw()),
        );
        let (n, subset) = if group < GROUPS {
            (5, "identify")
        } else {
            (1, "verify")
        };
        for _ in 0..n {
            let q: Vec<f64> = middle.iter().map(|q| q + 0.02 * random.draw()).collect();
            let seen = truth.seen(&q);
            let cells = q.iter().copied().chain((0..3).map(|k| seen[k] + own_mm[k]));
            let cells: Vec<String> = cells.map(|value| value.to_string()).collect();
            csv += &format!("{subset},{}\n", cells.join(","));
        }
    }
    csv
}

#[tokio::test]
async fn corrections_that_are_worse_than_the_links_on_the_verify_points_are_dropped_and_the_report_says_so()
 {
    let app = TestApp::with_workers(1).await;
    let robot = format!(
        "/v1/robots/{}",
        text(&app.post_json("/v1/robots", &arm()).await.ok(201)["id"])
    );
    let csv = misleading_groups(&mut Normal::new(5));
    let set = app.upload_csv(&robot, "frame=instrument", csv).await;
    let job = app
        .run(&robot, &json!({"measurement_set_id": set["id"]}))
        .await;
    let report = app.report(&job).await;
    let tried = report["corrections"].as_array().unwrap();
    assert!(
        tried.iter().all(|c| c["kept"] == false),
        "{:#}",
        report["corrections"]
    );
    let mut dropped = tried.iter().filter_map(|c| c["dropped_because"].as_str());
    assert!(
        dropped.any(|why| why == "worse_on_verify_points"),
        "they won the cross-validation: {tried:?}"
    );
    assert_eq!(report["verify"]["corrected"], report["verify"]["after"]);
    assert!(
        report["per_point"]
            .as_array()
            .unwrap()
            .iter()
            .all(|point| point["corrected_mm"] == point["after_mm"])
    );
    let warned = report["warnings"].as_array().unwrap().iter();
    assert_eq!(
        warned
            .filter(|w| w["code"] == "corrections_worse_on_verify_points")
            .count(),
        1,
        "{}",
        report["warnings"]
    );
    // All readers of corrections find none.
    let set = app.parameter_set(&job).await;
    assert!(set.get("corrections").is_none() && set.get("links_with_corrections").is_none());
    assert!(job.get("residual_network_id").is_none_or(Value::is_null));
    let networks = app.get(&format!("{robot}/networks")).await.ok(200);
    assert_eq!(networks["items"], json!([]));
}
