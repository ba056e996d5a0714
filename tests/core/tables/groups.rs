//! Means and other statistics behind each group of measurements, without a label.

use super::traps::{deviation, mean};
use super::*;

/// Knuth's linear congruential generator.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % limit
    }

    fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())]
    }

    /// Evenly distributed from −1 to 1.
    fn even(&mut self) -> f64 {
        self.below(2_000_001) as f64 / 1e6 - 1.0
    }

    /// Nearly normal, with standard deviation 1.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| 0.5 * self.even()).sum::<f64>()
    }
}

/// A campaign to be written.
struct Campaign {
    n_poses: usize,
    /// Measurements of each pose; of a random number if `None`.
    n_repeats: Option<usize>,
    decimals: usize,
    noise_mm: f64,
    joint_noise_deg: f64,
    /// The poses: random, on a grid, or of one joint that moves.
    poses: usize,
    n_targets: usize,
}

type Row = (Vec<f64>, Vec<f64>);

/// The measurements of each pose and each of its targets, rounded as they are written.
fn groups(campaign: &Campaign, random: &mut Random) -> Vec<(usize, Vec<Row>)> {
    let round = |value: f64, decimals: usize| {
        let factor = 10f64.powi(decimals as i32);
        (value * factor).round() / factor
    };
    let mut all = Vec::new();
    for pose in 0..campaign.n_poses {
        let q_deg: Vec<f64> = (0..6)
            .map(|joint| match campaign.poses {
                0 => 120.0 * random.even(),
                1 => [-30.0, 30.0, 0.0][(pose / 3usize.pow(joint % 3)) % 3],
                _ if joint == 1 => 5.0 * pose as f64,
                _ => 10.0,
            })
            .collect();
        let at_mm: Vec<f64> = match campaign.poses {
            0 => (0..3).map(|_| 1500.0 * random.even()).collect(),
            1 => {
                let [a, b, c] = [0, 1, 2].map(|joint: usize| q_deg[joint].to_radians());
                let reach_mm = 900.0 * b.cos() + 400.0 * (b + c).cos();
                vec![
                    reach_mm * a.cos(),
                    reach_mm * a.sin(),
                    900.0 * b.sin() + 400.0 * (b + c).sin(),
                ]
            }
            _ => vec![
                900.0 * q_deg[1].to_radians().cos(),
                900.0 * q_deg[1].to_radians().sin(),
                350.0,
            ],
        };
        for target in 0..campaign.n_targets {
            // targets in one line, evenly apart
            let offset_mm = [0.0, 100.0, 50.0][target];
            let n = campaign.n_repeats.unwrap_or_else(|| 1 + random.below(5));
            let rows = (0..n).map(|_| {
                let q = q_deg
                    .iter()
                    .map(|q| round(q + campaign.joint_noise_deg * random.normal(), 4));
                let q = q.collect();
                let p = at_mm.iter().map(|mm| {
                    round(
                        mm + offset_mm + campaign.noise_mm * random.normal(),
                        campaign.decimals,
                    )
                });
                (q, p.collect())
            });
            all.push((target, rows.collect()));
        }
    }
    all
}

fn line(target: usize, (q, p): &Row, decimals: usize) -> String {
    let q: Vec<String> = q.iter().map(|v| format!("{v:.4}")).collect();
    let p: Vec<String> = p.iter().map(|v| format!("{v:.decimals$}")).collect();
    format!("{target},{},{}\n", q.join(","), p.join(","))
}

fn column(rows: &[Row], at: usize) -> Vec<f64> {
    let value = |(q, p): &Row| if at < 6 { q[at] } else { p[at - 6] };
    rows.iter().map(value).collect()
}

/// A row of a statistic of these rows.
fn statistic(rows: &[Row], of: fn(&[f64]) -> f64) -> Row {
    let all: Vec<f64> = (0..9).map(|at| of(&column(rows, at))).collect();
    (all[..6].to_vec(), all[6..].to_vec())
}

fn range(values: &[f64]) -> f64 {
    let largest = values.iter().copied().fold(f64::MIN, f64::max);
    largest - values.iter().copied().fold(f64::MAX, f64::min)
}

fn titled(rows: &str) -> String {
    format!("target,{}\n{rows}", own_header().join(","))
}

#[test]
fn statistics_of_each_pose_are_no_measurements() {
    let mut random = Random(1);
    for case in 0..120 {
        let campaign = Campaign {
            n_poses: 8 + random.below(20),
            n_repeats: Some(2 + random.below(6)),
            decimals: 3 + random.below(3),
            noise_mm: [0.02, 0.05, 0.1][random.below(3)],
            joint_noise_deg: [0.0, 0.0, 0.002][random.below(3)],
            poses: random.below(3),
            n_targets: 1,
        };
        let is_in_front = random.below(4) == 0;
        let statistics: &[fn(&[f64]) -> f64] =
            random.of(&[&[mean], &[mean, deviation], &[mean, deviation, range]]);
        let has_own_joints = random.below(2) == 0;
        let (mut text, mut wanted, mut row) = (String::new(), vec![], 0);
        for (target, rows) in groups(&campaign, &mut random) {
            let mut block: Vec<Row> = statistics.iter().map(|of| statistic(&rows, *of)).collect();
            if has_own_joints {
                // the joint values of the pose beside every statistic of its position
                let q = block[0].0.clone();
                block.iter_mut().for_each(|row| row.0.clone_from(&q));
            }
            let first = if is_in_front { row } else { row + rows.len() };
            wanted.extend(first..first + block.len());
            row += rows.len() + block.len();
            let both = match is_in_front {
                true => [block, rows].concat(),
                false => [rows, block].concat(),
            };
            text.extend(both.iter().map(|row| line(target, row, campaign.decimals)));
        }
        let Err(error) = read(titled(&text).as_bytes(), "") else {
            panic!("case {case}: taken")
        };
        let found: Vec<usize> = error.issues.iter().filter_map(|issue| issue.row).collect();
        assert_eq!(
            error.issues[0].code, "summary_row",
            "case {case}: {:?}",
            error.issues[0]
        );
        assert_eq!(found, wanted[..found.len()], "case {case}");
        assert!(error.issues[0].detail.contains("remove such rows"));
        assert_eq!(error.issues[0].line, Some(wanted[0] + 2));
    }
}

#[test]
fn means_of_all_poses_behind_all_measurements_are_found() {
    let campaign = Campaign {
        n_poses: 12,
        n_repeats: Some(3),
        decimals: 4,
        noise_mm: 0.05,
        joint_noise_deg: 0.0,
        poses: 0,
        n_targets: 1,
    };
    let groups = groups(&campaign, &mut Random(2));
    let rows = groups.iter().flat_map(|(_, rows)| rows);
    let mut text: String = rows.map(|row| line(0, row, 4)).collect();
    text.extend(
        groups
            .iter()
            .map(|(_, rows)| line(0, &statistic(rows, mean), 4)),
    );
    let error = read(titled(&text).as_bytes(), "").unwrap_err();
    assert_eq!(
        (error.issues[0].code.as_str(), error.issues[0].row),
        ("summary_row", Some(36))
    );
}

#[test]
fn honest_tables_are_never_refused_as_statistics() {
    let mut random = Random(3);
    let (mut n_taken, mut n_exact) = (0, 0);
    for case in 0..400 {
        let decimals = random.below(5);
        let digit_mm = 10f64.powi(-(decimals as i32));
        let campaign = Campaign {
            n_poses: 2 + random.below(40),
            n_repeats: [None, Some(1 + random.below(6))][random.below(2)],
            decimals,
            // from exact repetitions to far above the resolution
            noise_mm: digit_mm * [0.0, 0.1, 0.2, 0.4, 1.0, 3.0, 30.0][random.below(7)],
            joint_noise_deg: [0.0, 0.0, 0.002][random.below(3)],
            poses: random.below(3),
            n_targets: 1 + random.below(3),
        };
        let groups = groups(&campaign, &mut random);
        let rows = groups
            .iter()
            .flat_map(|(target, rows)| rows.iter().map(|row| (*target, row)));
        let text: String = rows
            .map(|(target, row)| line(target, row, decimals))
            .collect();
        match read(titled(&text).as_bytes(), "") {
            Ok(_) => n_taken += 1,
            // repetitions that agree in every digit look like a table that stands there twice
            Err(error) if error.issues[0].code == "rows_twice" => {
                assert!(campaign.noise_mm < digit_mm, "case {case}");
                n_exact += 1;
            }
            // few rows with a target each name points
            Err(error) => assert_ne!(
                error.issues[0].code, "summary_row",
                "case {case}: {:?}",
                error.issues[0]
            ),
        }
    }
    println!("{n_taken} of 400 tables taken, {n_exact} refused as exact repetitions");
    assert!(n_taken + n_exact > 360, "{n_taken}, {n_exact}");
}
