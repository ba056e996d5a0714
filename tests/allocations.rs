//! Iterations of the swarm and steps of least squares allocate no memory, and a cell that repeats in a workbook is stored once.

#[path = "support/mod.rs"]
mod support;
use support::data;

use allocation_counter::measure;
use data::{paper_robot, paper_set};
use kincal::identification::KinematicModel;
use kincal::identification::model::objective::Observation;
use kincal::identification::model::parameters::{complete_parameters, paper_parameters};
use kincal::identification::model::search_space::SearchSpace;
use kincal::identification::search::fit::fit_in_space;
use kincal::identification::search::swarm::run_swarm;
use kincal::measurement::columns::mapping::Mapping;
use kincal::solvers::{least_squares, pso};
use kincal::wire::workbook::{Workbook, read};
use std::io::{Cursor, Write};
use std::ops::ControlFlow;

fn observations(set: &str) -> Vec<Observation> {
    let set = paper_set(set);
    let observation = |p: &kincal::measurement::Point| Observation {
        q_rad: p.q_rad.clone(),
        position_mm: p.position_mm,
        target: 0,
        weight: 1.0,
        whitening: None,
        rotation: None,
        station: None,
    };
    set.points.iter().map(observation).collect()
}

fn spaces(observations: &[Observation]) -> [SearchSpace; 2] {
    let links = paper_robot().links;
    let scale = |n: usize| vec![0.01; n];
    let (paper, complete) = (
        paper_parameters(links.len()),
        complete_parameters(links.len(), 1),
    );
    let (of_paper, of_complete) = (scale(paper.len()), scale(complete.len()));
    [
        SearchSpace::raw(KinematicModel::nominal(&links, 1), paper, of_paper),
        SearchSpace::singular(
            KinematicModel::nominal(&links, 1),
            complete,
            of_complete,
            observations,
        ),
    ]
}

#[test]
fn a_swarm_iteration_allocates_nothing() {
    let observations = observations("first_noisy.csv");
    for space in spaces(&observations) {
        let allocations = |n_iterations: usize| {
            let options = pso::Options {
                n_particles: 43,
                n_iterations,
                ..pso::Options::default()
            };
            measure(|| {
                drop(run_swarm(
                    &space,
                    &observations,
                    None,
                    &options,
                    None,
                    &mut |_| ControlFlow::Continue(()),
                ))
            })
            .count_total
        };
        let few = allocations(2);
        assert!(few > 0, "the counter counts");
        assert_eq!(allocations(60), few);
    }
}

#[test]
fn an_undamped_least_squares_step_allocates_nothing() {
    // Without noise: with raw parameters, damped steps would follow the noise along directions that the data hardly determine.
    let observations = observations("first.csv");
    for space in spaces(&observations) {
        let allocations = |max_iterations: usize| {
            let options = least_squares::Options {
                max_iterations,
                ..least_squares::Options::default()
            };
            let mut steps = 0;
            let measured = measure(|| {
                let fit = fit_in_space(&space, &observations, &options, &mut |_| {
                    ControlFlow::Continue(())
                });
                steps = fit.summary.n_iterations;
            });
            assert_eq!(steps, max_iterations, "not at the minimum yet");
            measured.count_total
        };
        assert_eq!(allocations(2), allocations(1));
    }
}

/// An ods workbook of some kilobytes: one cell of this many letters, which is repeated 20 times.
fn repeated_cell(n_letters: usize) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default();
    archive.start_file("content.xml", options).unwrap();
    let text = "a".repeat(n_letters);
    write!(
        archive,
        "<x><table:table table:name=\"a\"><table:table-row><table:table-cell table:number-columns-repeated=\"20\"><text:p>{text}</text:p>\
         </table:table-cell></table:table-row></table:table></x>"
    )
    .unwrap();
    archive.finish().unwrap().into_inner()
}

#[test]
fn a_long_cell_that_repeats_is_refused_before_it_fills_the_memory() {
    const MIB: u64 = 1 << 20;
    let workbook = repeated_cell(33 << 20);
    assert!((workbook.len() as u64) < MIB);
    let used = measure(|| {
        let error = read(Workbook::Ods, &workbook, &Mapping::default()).unwrap_err();
        assert_eq!(error.issues[0].code, "too_large");
    });
    assert!(used.bytes_max < 400 * MIB, "{} MiB", used.bytes_max / MIB);
}
