//! How well robots are identified: measured ones, and simulated ones with what goes wrong in a cell. Prints `docs/identification.md`.
//!
//! `cargo run --release --example study identification [all|real|outliers|campaigns|steps|starts|swarm] [n]`
//! `cargo run --release --example study identification splits DIR` writes the splits that `docs/oracles/scipy_least_squares.py` reads.

mod campaigns;
mod outliers;
mod real;
mod starts;
mod steps;
mod swarm;

/// Runs the study.
pub fn study(arguments: &[String]) {
    let what = arguments.first().map_or("all", String::as_str);
    if let ("splits", Some(folder)) = (what, arguments.get(1)) {
        return real::write_splits(std::path::Path::new(folder));
    }
    let n: Option<u64> = arguments.get(1).and_then(|n| n.parse().ok());
    let wanted = |name: &str| what == "all" || what == name;
    if wanted("real") {
        real::tables();
    }
    if wanted("starts") {
        starts::table(n.unwrap_or(100));
    }
    if wanted("swarm") {
        swarm::table(n.unwrap_or(50));
    }
    if wanted("outliers") {
        outliers::table(n.unwrap_or(100));
    }
    if wanted("campaigns") {
        campaigns::table(n.unwrap_or(100));
    }
    if wanted("steps") {
        steps::table(n.unwrap_or(1000));
    }
}
