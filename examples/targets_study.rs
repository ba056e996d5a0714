//! Corrected targets and pose plans: how many a second, and how much better than random poses.
//!
//!     cargo run --release --example targets_study [plans|targets]

#[path = "../tests/support/robots.rs"]
mod robots;
#[path = "../tests/support/simulation.rs"]
mod simulation;

use kincal::compensation::{Compensation, Mode, Status, Tool};
use kincal::identification::Model;
use kincal::kinematics::{Link, Robot};
use kincal::planning::{PlanRequest, Room, plan};
use nalgebra::{IsometryMatrix3, Rotation3, Translation3, Vector3};
use rand::RngExt;
use simulation::{Normal, poses};
use std::time::Instant;

fn main() {
    let what = std::env::args().nth(1).unwrap_or_default();
    if what != "plans" {
        targets();
    }
    if what != "targets" {
        plans();
    }
}

/// 20,000 targets of the paper's arm, all over its joint space, wrist singularities among them.
fn targets() {
    let nominal = robots::models()[0].1.clone();
    let mut random = Normal::new(1);
    let truth = simulation::true_robot(&nominal, 1, &mut random);
    let compensation = Compensation::new(&nominal, &truth.links);
    let tool = Tool::Tcp(IsometryMatrix3::from_parts(Translation3::new(30.0, -45.0, 160.0), Rotation3::identity()));
    let all = poses(20_000, &mut random);
    println!("mode      targets/s  ok      near_singular  not_reached  largest change of a joint of the ok ones");
    for mode in [Mode::Pose, Mode::Position] {
        let since = Instant::now();
        let corrected: Vec<_> = all.iter().map(|q| compensation.correct(q, &tool, mode)).collect();
        let rate = all.len() as f64 / since.elapsed().as_secs_f64();
        let count = |status| corrected.iter().filter(|c| c.status == status).count();
        let change = |(c, q): (&kincal::compensation::Corrected, &Vec<f64>)| {
            c.q_controller_rad.iter().zip(q).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        let ok = corrected.iter().zip(&all).filter(|(c, _)| c.status == Status::Ok);
        let largest = ok.map(change).fold(0.0, f64::max).to_degrees();
        let name = format!("{mode:?}");
        let (ok, near, not) = (count(Status::Ok), count(Status::NearSingular), count(Status::NotReached));
        println!("{name:9} {rate:9.0}  {ok:6}  {near:13}  {not:11}  {largest:.2}°");
    }
}

/// Twenty robots: the six kinds with links changed at random, limits at random.
fn plans() {
    println!("robot       n   planned mm  random mm  gain   o1 planned  seconds");
    let models = robots::models();
    let mut gains: Vec<(usize, f64)> = Vec::new();
    for i in 0..20 {
        let (name, robot) = &models[i % models.len()];
        let mut random = Normal::new(500 + i as u64);
        let robot = another(robot, &mut random);
        for n in [20, 50] {
            let request = PlanRequest {
                robot: &robot,
                model: Model::Complete,
                target_mm: Vector3::new(80.0, 0.0, 100.0),
                n_configurations: n,
                n_repeats: 3,
                n_candidates: 10_000,
                noise_std_mm: 0.05,
                seed: i as u64,
                room: Room::default(),
                measured: vec![],
            };
            let since = Instant::now();
            let plan = plan(&request).expect("room enough");
            let seconds = since.elapsed().as_secs_f64();
            let (planned, random) = (plan.predicted.mean_mm, plan.predicted_random.mean_mm);
            println!(
                "{name:10} {n:3}  {planned:10.4}  {random:9.4}  {:.2}  {:10.4}  {seconds:.2}",
                random / planned,
                plan.observability_index_o1
            );
            gains.push((n, random / planned));
        }
    }
    for n in [20, 50] {
        let mut of: Vec<f64> = gains.iter().filter(|(m, _)| *m == n).map(|(_, gain)| *gain).collect();
        of.sort_by(f64::total_cmp);
        println!("{n} poses: gain {:.2} to {:.2}, median {:.2}", of[0], of[of.len() - 1], of[of.len() / 2]);
    }
}

/// A robot of the same kind: lengths up to 20 % other, limits of 60° to 170° to both sides.
fn another(robot: &Robot, random: &mut Normal) -> Robot {
    let mut stretched = |mm: f64| mm * (0.8 + 0.4 * random.0.random::<f64>());
    let links: Vec<Link> = robot.links.iter().map(|l| Link { a_mm: stretched(l.a_mm), d_mm: stretched(l.d_mm), ..*l }).collect();
    let limits = (0..links.len()).map(|_| Some((-(60.0 + 110.0 * random.0.random::<f64>()), 60.0 + 110.0 * random.0.random::<f64>())));
    let limits = limits.map(|l| l.map(|(low, high)| (low.to_radians(), high.to_radians()))).collect();
    Robot { joint_limits_rad: limits, ..Robot::from_links(links) }
}
