//! How often a right upload is refused by the alignment check: `cargo run --release --example alignment_study 1000 > docs/alignment.md`.

#[path = "../tests/support/robots.rs"]
mod robots;
#[path = "../tests/support/simulation.rs"]
mod simulation;

fn main() {
    let n: usize = std::env::args().nth(1).and_then(|text| text.parse().ok()).unwrap_or(1000);
    let counts = robots::clean_robots(n, 1);
    println!("# Right uploads and the alignment check\n");
    println!("Made by `cargo run --release --example alignment_study {n} > docs/alignment.md`.\n");
    println!(
        "Simulated robots with errors of 0.5 mm and 0.1° (one standard deviation) in every parameter, measured with 0.05 mm noise at 10 to 80"
    );
    println!("poses, half of them in the base frame. All are right: none should be refused.\n");
    println!("| make | refused | with a remark | accepted |\n|---|---|---|---|");
    for (name, [refused, odd, fine]) in &counts {
        println!("| {name} | {refused} | {odd} | {fine} |");
    }
    let sum = |i: usize| counts.iter().map(|(_, outcome)| outcome[i]).sum::<usize>();
    println!("| all | {} | {} | {} |", sum(0), sum(1), sum(2));
}
