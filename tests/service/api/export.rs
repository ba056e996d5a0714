use crate::api::closed_loop::{arm, campaign, nominal, real_robot};
use crate::api::compensate::parameter_set;
use crate::app::{Answer, TestApp, text};
use crate::real_robot::RealRobot;
use crate::simulation::Normal;
use reqwest::Method;
use serde_json::{Value, json};
use std::path::PathBuf;
use std::process::Command;

/// 4 × 4, row by row.
type Pose = [[f64; 4]; 4];

fn times(a: &Pose, b: &Pose) -> Pose {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

fn turn(axis: usize, angle: f64) -> Pose {
    let (s, c) = angle.sin_cos();
    let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut m: Pose = std::array::from_fn(|i| std::array::from_fn(|l| f64::from(u8::from(i == l))));
    (m[j][j], m[j][k], m[k][j], m[k][k]) = (c, -s, s, c);
    m
}

fn shift(xyz: [f64; 3]) -> Pose {
    let mut m = turn(0, 0.0);
    (0..3).for_each(|i| m[i][3] = xyz[i]);
    m
}

fn product(parts: impl IntoIterator<Item = Pose>) -> Pose {
    parts.into_iter().fold(turn(0, 0.0), |a, b| times(&a, &b))
}

/// The flange by the links of the parameter set as JSON: Rx·Dx·Ry·Rz·Dz.
fn by_links(links: &Value, q_rad: &[f64]) -> Pose {
    let link = |(link, q): (&Value, &f64)| {
        let number = |name: &str| link[name].as_f64().unwrap();
        product([
            turn(0, number("alpha_deg").to_radians()),
            shift([number("a_mm"), 0.0, 0.0]),
            turn(1, number("beta_deg").to_radians()),
            turn(2, q + number("theta_offset_deg").to_radians()),
            shift([0.0, 0.0, number("d_mm")]),
        ])
    };
    product(links.as_array().unwrap().iter().zip(q_rad).map(link))
}

fn origin(xyz_m: [f64; 3], rpy: [f64; 3]) -> Pose {
    product([
        shift(xyz_m.map(|m| m * 1e3)),
        turn(2, rpy[2]),
        turn(1, rpy[1]),
        turn(0, rpy[0]),
    ])
}

#[track_caller]
fn same(a: &Pose, b: &Pose) {
    for i in 0..3 {
        for j in 0..4 {
            let limit = if j == 3 { 1e-9 } else { 1e-12 };
            assert!(
                (a[i][j] - b[i][j]).abs() < limit,
                "{i}{j}: {} {}",
                a[i][j],
                b[i][j]
            );
        }
    }
}

/// Seeded by hand.
fn configurations() -> Vec<Vec<f64>> {
    (0..20)
        .map(|i| {
            (0..6)
                .map(|j| 3.0 * (f64::from(i * 6 + j) * 12.9898).sin())
                .collect()
        })
        .collect()
}

fn between<'t>(text: &'t str, before: &str, after: &str) -> Vec<&'t str> {
    text.split(before)
        .skip(1)
        .map(|part| part.split(after).next().unwrap())
        .collect()
}

fn three(text: &str) -> [f64; 3] {
    let numbers: Vec<f64> = text
        .split_whitespace()
        .map(|n| n.parse().unwrap())
        .collect();
    numbers.try_into().unwrap()
}

/// The chain of a URDF that we exported, by a simple search for quotation marks.
fn by_urdf(text: &str, q_rad: &[f64]) -> Pose {
    let joints = text
        .split("<joint ")
        .skip(1)
        .filter(|joint| !joint.contains("type=\"fixed\""));
    let joint = |(joint, q): (&str, &f64)| {
        let value = |name: &str| three(between(joint, &format!("{name}=\""), "\"")[0]);
        let axis = three(between(joint.split("<axis").nth(1).unwrap(), "xyz=\"", "\"")[0]);
        assert_eq!((axis[0], axis[1]), (0.0, 0.0));
        product([origin(value("xyz"), value("rpy")), turn(2, axis[2] * q)])
    };
    product(joints.zip(q_rad).map(joint))
}

#[tokio::test]
async fn every_format_has_the_identified_kinematics() {
    let app = TestApp::with_workers(1).await;
    let set = parameter_set(&app).await;
    let links = app.get(&set).await.ok(200)["links"].clone();
    let export = async |query: &str| app.get(&format!("{set}/export{query}")).await;
    let json = export("").await;
    assert_eq!(json.header("content-type"), Some("application/json"));
    let (json, yaml) = (json.ok(200), export("?format=yaml").await);
    let yaml: Value = yaml_serde::from_str(&yaml.text()).unwrap();
    let csv = export("?format=csv").await.text();
    let from_csv: Vec<Value> = csv
        .lines()
        .skip(1)
        .map(|line| {
            let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
            json!({"a_mm": cells[1], "alpha_deg": cells[2], "d_mm": cells[3], "theta_offset_deg": cells[4], "beta_deg": cells[5]})
        })
        .collect();
    let urdf = export("?format=urdf").await;
    assert_eq!(urdf.header("content-type"), Some("application/xml"));
    let robots = app.get("/v1/overview").await.ok(200);
    let day = &text(&robots["items"][0]["created_at"])[..10];
    let id = text(&json["parameter_set_id"]);
    assert_eq!(
        urdf.header("content-disposition").unwrap(),
        format!("attachment; filename=\"ER20-C10_{day}_{id}.urdf\"")
    );
    let urdf = urdf.text();
    for q in configurations() {
        let meant = by_links(&links, &q);
        same(&meant, &by_links(&json["links"], &q));
        same(&meant, &by_links(&yaml["links"], &q));
        same(&meant, &by_links(&json!(from_csv), &q));
        same(&meant, &by_urdf(&urdf, &q));
    }
    assert_eq!(json["robot"]["name"], "ER20-C10");
    let mastering = export("?format=mastering").await;
    assert!(
        mastering
            .header("kincal-remaining-error-mm")
            .unwrap()
            .starts_with("mean=")
    );
    let mastering = mastering.ok(200);
    assert_eq!(mastering["joints"].as_array().unwrap().len(), 6);
    assert!(mastering["remaining_error_mm"]["mean"].as_f64().unwrap() > 0.0);
    let refitted = export("?beta=refit").await;
    assert!(refitted.header("kincal-remaining-error-mm").is_some());
    assert!(
        refitted.ok(200)["links"]
            .as_array()
            .unwrap()
            .iter()
            .all(|link| link["beta_deg"] == 0.0)
    );
    export("?format=pdf").await.problem(400, "invalid_query");
    // The paper's arm is not made by Universal Robots.
    let refused = export("?format=ur_kinematics").await;
    refused.problem(422, "not_a_universal_robot");
}

/// The maker's description of the UR10e, if it is available.
pub fn ur10e_description() -> Option<String> {
    let mut all = crate::data::urdfs().into_iter();
    Some(
        all.find(|(name, _)| name.ends_with("Description__ur10e"))?
            .1,
    )
}

/// A UR10e as registered by importing its description, and the real one: with typical factory errors and a reflector.
pub async fn ur10e(
    app: &TestApp,
    urdf: &str,
    target_mm: [f64; 3],
    random: &mut Normal,
) -> (String, RealRobot) {
    let path = "/v1/robot-imports?format=urdf&name=UR10e";
    let imported = app
        .post(path, "application/xml", urdf.to_owned())
        .await
        .ok(200);
    let robot = app
        .post_json("/v1/robots", &imported["robot"])
        .await
        .ok(201);
    let number = |link: &Value, name: &str| link[name].as_f64().unwrap_or(0.0);
    let as_row = |l: &Value| {
        [
            number(l, "a_mm"),
            number(l, "alpha_deg").to_radians(),
            number(l, "d_mm"),
            number(l, "theta_offset_deg").to_radians(),
            number(l, "beta_deg").to_radians(),
        ]
    };
    let nominal = imported["robot"]["links"].as_array().unwrap();
    let mut links: Vec<[f64; 5]> = nominal.iter().map(as_row).collect();
    for (i, link) in links.iter_mut().enumerate() {
        link[0] += 0.3 * random.draw();
        link[1] += 1e-3 * random.draw();
        if i < 5 {
            // For the last link these describe the position of the reflector.
            link[2] += 0.3 * random.draw();
            link[3] += 5e-3 * random.draw();
        }
    }
    let truth = RealRobot {
        links,
        give_rad: vec![0.0; 6],
        masses: vec![0.0; 6],
        eccentric_rad: vec![[0.0; 4]; 6],
        target_mm,
        t_instrument_base: crate::real_robot::shift([0.0; 3]),
    };
    (format!("/v1/robots/{}", text(&robot["id"])), truth)
}

/// A UR10e with typical factory errors is imported from its maker's description, measured in its base frame, identified and exported. The
/// description with the exported origins, as its users load it, has the reflector at the robot's position.
#[tokio::test]
async fn a_universal_robot_from_its_makers_description_points_where_it_should() {
    let Some(urdf) = ur10e_description() else {
        return;
    };
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(15);
    let (robot, truth) = ur10e(&app, &urdf, [60.0, -20.0, 80.0], &mut random).await;
    let poses = |random: &mut Normal, n| -> Vec<Vec<f64>> {
        (0..n).map(|_| random.pose(&[170.0; 6])).collect()
    };
    let measured = poses(&mut random, 80);
    let csv = crate::api::closed_loop::csv(&truth, &measured, &mut random);
    let path = format!("{robot}/measurement-sets?frame=base");
    let set = app.post(&path, "text/csv", csv).await.ok(201);
    let job = app
        .run(
            &robot,
            &json!({"measurement_set_id": set["id"], "corrections": "off", "model": "complete"}),
        )
        .await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let set = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    let kinematics = app.get(&format!("{set}/export?format=ur_kinematics")).await;
    assert_eq!(kinematics.status, 200, "{}", kinematics.text());
    let printed = kinematics.text();
    assert!(printed.contains("begin in: base_link."), "{printed}");
    assert!(
        printed.contains("# The measured positions place the robot's base at"),
        "{printed}"
    );
    let q = poses(&mut random, 30);
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let output = Command::new(crate::data::oracles_python())
        .arg(format!(
            "{}/docs/oracles/read_ur_description.py",
            env!("CARGO_MANIFEST_DIR")
        ))
        .arg(file("robot.urdf", &urdf))
        .arg(file("kinematics.yaml", &printed))
        .arg(file("q.json", &json!(q).to_string()))
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    let identified = app.get(&set).await.ok(200);
    let reflector: Vec<f64> =
        serde_json::from_value(identified["targets"][0]["position_mm"].clone()).unwrap();
    let place = &identified["t_instrument_base"];
    let mut worst = 0.0f64;
    for (q, t) in q.iter().zip(found["t_base_link_tool0"].as_array().unwrap()) {
        let number = |value: &Value| value.as_f64().unwrap();
        let at: [f64; 3] = std::array::from_fn(|i| {
            (0..3).map(|j| number(&t[i][j]) * reflector[j]).sum::<f64>() + number(&t[i][3])
        });
        let measured: [f64; 3] = std::array::from_fn(|i| {
            (0..3)
                .map(|j| number(&place["rotation"][i][j]) * at[j])
                .sum::<f64>()
                + number(&place["translation_mm"][i])
        });
        worst = worst.max(crate::api::closed_loop::distance(measured, truth.seen(q)));
    }
    println!(
        "{}: the reflector at most {worst:.3} mm off",
        found["readers"]
    );
    // The noise of 0.03 mm over 80 poses. Without base_link_inertia the error is 2,555 mm.
    assert!(worst < 0.1, "{worst}");
}

/// `docs/oracles/read_exports.py` shares nothing with kincal's code, nor with the readers above.
#[tokio::test]
async fn a_reader_in_another_language_moves_every_export_alike() {
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(9);
    let robot = format!(
        "/v1/robots/{}",
        text(&app.post_json("/v1/robots", &arm()).await.ok(201)["id"])
    );
    let truth = real_robot(&nominal(&arm()), &mut random);
    let path = format!("{robot}/measurement-sets?frame=instrument");
    let uploaded = app
        .post(&path, "text/csv", campaign(&truth, 60, &mut random))
        .await
        .ok(201);
    let job = app
        .run(
            &robot,
            &json!({"measurement_set_id": uploaded["id"], "corrections": "off"}),
        )
        .await;
    let set = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    // Beta of parallel axes, which a table without beta cannot represent.
    assert!(
        app.get(&set).await.ok(200)["links"][2]["beta_deg"]
            .as_f64()
            .unwrap()
            .abs()
            > 1e-3
    );
    let folder = tempfile::tempdir().unwrap();
    let mut files = Vec::new();
    for format in ["json", "yaml", "csv", "urdf"] {
        let file = folder.path().join(format!("set.{format}"));
        let answer = app.get(&format!("{set}/export?format={format}")).await;
        assert_eq!(answer.status, 200, "{format}: {}", answer.text());
        std::fs::write(&file, answer.bytes).unwrap();
        files.push(file);
    }
    let script = format!(
        "{}/docs/oracles/read_exports.py",
        env!("CARGO_MANIFEST_DIR")
    );
    let run = |files: &[PathBuf]| {
        Command::new("python3")
            .arg(&script)
            .args(files)
            .output()
            .unwrap()
    };
    let output = run(&files);
    let printed = String::from_utf8_lossy(&output.stdout);
    println!("{printed}");
    assert!(
        output.status.success(),
        "{printed}{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let read = printed.lines().filter(|line| line.contains(" mm ")).count();
    let left_out = printed
        .lines()
        .filter(|line| line.contains("PyYAML"))
        .count();
    assert!(read >= 2 && read + left_out == 3, "{printed}");
    // The check is sensitive: it detects a tenth of a micrometre in one row of the table.
    let table = std::fs::read_to_string(&files[2]).unwrap();
    let mut rows: Vec<Vec<String>> = table
        .lines()
        .map(|line| line.split(',').map(str::to_owned).collect())
        .collect();
    let column = rows[0].iter().position(|name| name == "a_mm").unwrap();
    rows[3][column] = (rows[3][column].parse::<f64>().unwrap() + 1e-4).to_string();
    std::fs::write(
        &files[2],
        rows.iter()
            .map(|row| row.join(",") + "\n")
            .collect::<String>(),
    )
    .unwrap();
    assert_eq!(run(&files).status.code(), Some(1));
}

#[tokio::test]
async fn a_users_urdf_is_patched_and_a_wrong_one_refused() {
    let app = TestApp::with_workers(1).await;
    let set = parameter_set(&app).await;
    let links = app.get(&set).await.ok(200)["links"].clone();
    // The nominal robot as the service itself exports it, with a comment and a mesh of the user.
    let robot = String::from_utf8(crate::app::paper("robot.json")).unwrap();
    let table = serde_json::from_str::<Value>(&robot).unwrap()["links"].clone();
    let mut own = String::from("<robot name='mine'><!-- keep me -->\n<link name='base_link'/>");
    for (i, link) in table.as_array().unwrap().iter().enumerate() {
        let number = |name: &str| link[name].as_f64().unwrap();
        let (a, alpha, d) = (
            number("a_mm") / 1e3,
            number("alpha_deg").to_radians(),
            number("d_mm") / 1e3,
        );
        // Rx(alpha)·Dx(a)·Dz(d): d is along the rotated z.
        let xyz = format!("{a} {} {}", -alpha.sin() * d, alpha.cos() * d);
        own += &format!(
            "<link name='link_{}'><visual><origin xyz='9 9 9'/></visual></link>\n<joint name='j{i}' type='continuous'><parent link='{}'/><child link='link_{}'/><origin xyz=\"{xyz}\" rpy=\"{alpha} 0 0\"/><axis xyz=\"0 0 1\"/></joint>\n",
            i + 1,
            if i == 0 {
                "base_link".into()
            } else {
                format!("link_{i}")
            },
            i + 1
        );
    }
    own += "</robot>";
    let patch = async |text: String| {
        Answer::of(
            app.request(Method::POST, &format!("{set}/export?format=urdf"))
                .header("content-type", "application/xml")
                .body(text),
        )
        .await
    };
    let answer = patch(own.clone()).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    let patched = answer.text();
    for q in configurations() {
        same(&by_links(&links, &q), &by_urdf(&patched, &q));
    }
    let skeleton = |text: &str| {
        text.split("<origin xyz=\"")
            .map(|part| {
                part.split_once("/><axis")
                    .map_or(part, |(_, rest)| rest)
                    .to_owned()
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(skeleton(&own), skeleton(&patched));
    let problem = patch(own.replace("0.78227", "0.9"))
        .await
        .problem(422, "urdf_mismatch");
    assert!(text(&problem["detail"]).contains("j"), "{problem}");
    patch("<robot".into()).await.problem(422, "not_xml");
    let wrong = Answer::of(
        app.request(Method::POST, &format!("{set}/export?format=csv"))
            .body(own),
    )
    .await;
    wrong.problem(400, "invalid_query");
}

#[tokio::test]
async fn robots_are_imported_from_urdf_and_tables() {
    let app = TestApp::spawn().await;
    let import = async |query: &str, body: &str| {
        Answer::of(
            app.request(Method::POST, &format!("/v1/robot-imports?{query}"))
                .header("content-type", "text/csv")
                .body(body.to_owned()),
        )
        .await
    };
    let distal = "theta_offset_deg,d_mm,a_mm,alpha_deg\n0,504,166.605,-90\n0,0,782.27,0\n0,0,138.826,-90\n0,761.35,0,90\n0,0,0,-90\n0,125,0,0\n";
    let answer = import("format=dh&name=mine", distal).await.ok(200);
    assert_eq!(answer["robot"]["name"], "mine");
    // The paper's robot has the same table in Craig's convention.
    let paper: Value = serde_json::from_slice(&crate::app::paper("robot.json")).unwrap();
    for (a, b) in answer["robot"]["links"]
        .as_array()
        .unwrap()
        .iter()
        .zip(paper["links"].as_array().unwrap())
    {
        for name in ["a_mm", "alpha_deg", "d_mm", "theta_offset_deg"] {
            assert!(
                (a[name].as_f64().unwrap() - b[name].as_f64().unwrap()).abs() < 1e-12,
                "{a} {b}"
            );
        }
    }
    app.post_json("/v1/robots", &answer["robot"]).await.ok(201);
    let problem = import(
        "format=mdh",
        "a_mm,alpha_deg,d_mm,theta_offset_deg\n1,2,3,4\n1,x,3,4\n",
    )
    .await
    .problem(422, "invalid_table");
    assert_eq!(
        (
            &problem["errors"][0]["row"],
            &problem["errors"][0]["column"]
        ),
        (&json!(1), &json!("alpha_deg"))
    );
    import("format=mdh", "a,alpha_deg,d_mm,theta_offset_deg\n1,2,3,4\n")
        .await
        .problem(422, "invalid_table");
    import("format=urdf", "<robot/>")
        .await
        .problem(422, "no_joints");
}
