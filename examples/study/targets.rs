//! Corrected targets and pose plans: how many a second, and how much better than random poses, beside what no plan can do better. The tables
//! of docs/compensation.md and docs/pose-plans.md.
//!
//!     cargo run --release --example study targets [plans|targets]

mod plans;

use crate::robots;
use crate::simulation;
use crate::simulation::{Normal, poses};
use kincal::compensation::{Compensation, Mode, Status, Tool};
use nalgebra::{IsometryMatrix3, Rotation3, Translation3};
use std::time::Instant;

/// Runs the study.
pub fn study(arguments: &[String]) {
    let what = arguments.first().cloned().unwrap_or_default();
    if what != "plans" {
        targets();
    }
    if what != "targets" {
        plans::table();
    }
}

/// 20,000 targets of the paper's arm, all over its joint space, wrist singularities among them.
fn targets() {
    let nominal = robots::models()[0].1.clone();
    let mut random = Normal::new(1);
    let truth = simulation::true_robot(&nominal, 1, &mut random);
    let compensation = Compensation::new(&nominal, &truth.links);
    let tool = Tool::Tcp(IsometryMatrix3::from_parts(
        Translation3::new(30.0, -45.0, 160.0),
        Rotation3::identity(),
    ));
    let all = poses(20_000, &mut random);
    println!(
        "| mode | targets per second | ok | near_singular | joint_limit | not_reached | largest change of a joint of the ok ones |"
    );
    println!("|---|---|---|---|---|---|---|");
    for mode in [Mode::Pose, Mode::Position] {
        let since = Instant::now();
        let corrected: Vec<_> = all
            .iter()
            .map(|q| compensation.correct(q, &tool, mode))
            .collect();
        let rate = all.len() as f64 / since.elapsed().as_secs_f64();
        let count = |status| corrected.iter().filter(|c| c.status == status).count();
        let change = |(c, q): (&kincal::compensation::Corrected, &Vec<f64>)| {
            c.q_controller_rad
                .iter()
                .zip(q)
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f64::max)
        };
        let ok = corrected
            .iter()
            .zip(&all)
            .filter(|(c, _)| c.status == Status::Ok);
        let largest = ok.map(change).fold(0.0, f64::max).to_degrees();
        let (ok, near) = (count(Status::Ok), count(Status::NearSingular));
        let (limit, not) = (count(Status::JointLimit), count(Status::NotReached));
        println!("| {mode:?} | {rate:.0} | {ok} | {near} | {limit} | {not} | {largest:.2}° |");
    }
    println!();
}
