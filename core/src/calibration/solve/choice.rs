//! Chooses the method and its start, with the reason.

use crate::calibration::preparation::observe::placed;
use crate::calibration::preparation::row_weights::start_of_poses;
use crate::calibration::problem::Problem;
use crate::calibration::request::Method;
use crate::identification::KinematicModel;
use crate::identification::least_squares::multistart::{BestStart, best_start};
use crate::identification::model::objective::Observation;
use crate::identification::model::parameters::apply;

/// The chosen method, its start, and the reason.
pub struct Choice {
    /// The method; never `Auto`.
    pub method: Method,
    /// Start of least squares, and centre of a swarm's box.
    pub start: KinematicModel,
    /// The same for a swarm without the network, for comparison.
    pub cold_start: KinematicModel,
    /// Reason for the choice, in words.
    pub reason: String,
}

/// For `auto`: least squares if it finds the robot. It starts from nominal or, if joints are far off, from the network's stored answer or from the
/// best of other joint offsets. If least squares does not find the robot: a swarm around the best start, moved by the network if there is one.
pub fn choose(problem: &Problem<'_>) -> Choice {
    let asked_for = |start: KinematicModel| Choice {
        method: problem.request.method,
        start,
        cold_start: problem.nominal.clone(),
        reason: "asked for".into(),
    };
    match problem.request.method {
        Method::Auto => by_evidence(problem),
        Method::BpnnPso => asked_for(KinematicModel {
            links: problem.nominal.links.clone(),
            ..remembered(problem)
        }),
        Method::LeastSquares | Method::Pso => asked_for(problem.nominal.clone()),
    }
}

fn by_evidence(problem: &Problem<'_>) -> Choice {
    let n_targets = problem.screening.targets.len();
    let placed = |links, points: &[Observation]| placed(problem.request, links, points, n_targets);
    let network = problem.network().map(|_| remembered(problem));
    let has_poses = problem.request.set.has_poses();
    let mut best = match has_poses {
        true => start_of_poses(problem),
        false => best_start(
            &problem.nominal,
            network.as_ref(),
            &problem.parameters,
            &problem.identify,
            problem.request.stated_position_std_mm(),
            &placed,
        ),
    };
    let (mut method, mut reason) = evidence(&best);
    if has_poses && method != Method::LeastSquares {
        method = Method::LeastSquares;
        reason = format!(
            "{reason}, which takes positions alone; of poses, least squares goes on from there"
        );
    }
    if has_poses && best.model != problem.nominal {
        best.model = placed(best.model.links.clone(), &problem.identify);
    }
    Choice {
        method,
        cold_start: best.model.clone(),
        start: best.model,
        reason,
    }
}

/// If least squares from nominal converges, neither reason nor result depends on whether a network exists.
fn evidence(best: &BestStart) -> (Method, String) {
    let left_out = if best.needed_trimming {
        ", the quarter of them left out that fits worst"
    } else {
        ""
    };
    let from_nominal = format!(
        "least squares from nominal ended with half of the points within {:.3} mm{left_out}",
        best.from_nominal_mm
    );
    if best.from_nominal_mm <= best.found_mm && best.needed_trimming {
        return (
            Method::LeastSquares,
            format!("{from_nominal}: from there it converges. Look for wild points"),
        );
    }
    if best.from_nominal_mm <= best.found_mm {
        return (
            Method::LeastSquares,
            format!(
                "{from_nominal}: it converges, in a few steps and to the same answer every time"
            ),
        );
    }
    let from_network =
        |mm: f64| format!("; from what the robot's network remembers, within {mm:.3} mm");
    let tried = format!(
        "{from_nominal}, which is no fit{}",
        best.from_remembered_mm
            .map(from_network)
            .unwrap_or_default()
    );
    let (n, best_mm) = (best.n_starts, best.best_mm);
    match (best_mm <= best.found_mm, n, best.from_remembered_mm) {
        (true, 0, _) => (
            Method::LeastSquares,
            format!("{tried}. Check the mastering of the joints"),
        ),
        (true, _, _) => {
            let others = format!(
                "with other joint offsets, placed anew, the {n}th start reached {best_mm:.3} mm"
            );
            (
                Method::LeastSquares,
                format!("{tried}; {others}. Check the mastering of the joints"),
            )
        }
        (false, 0, _) => (
            Method::LeastSquares,
            format!("{tried}, and no joint offset is free: there is nowhere else to start from"),
        ),
        (false, _, remembered) => {
            let others =
                format!("{n} starts with other joint offsets came no nearer than {best_mm:.3} mm");
            let (method, swarm) = match remembered {
                Some(_) => (Method::BpnnPso, "a swarm that the network moves searches"),
                None => (Method::Pso, "a swarm searches"),
            };
            (
                method,
                format!("{tried}, and {others}: {swarm} around the best of them"),
            )
        }
    }
}

/// The links that the network was trained on, with base and targets fitted to them. With the nominal links, base and targets would be wrong by as
/// much as the robot's errors.
fn remembered(problem: &Problem<'_>) -> KinematicModel {
    let remembered = apply(
        &problem.nominal,
        &problem.parameters,
        &problem.answer_deviation(),
    );
    placed(
        problem.request,
        remembered.links,
        &problem.identify,
        problem.screening.targets.len(),
    )
}
