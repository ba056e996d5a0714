//! Orders configurations for short moves.

/// Maximum number of passes of exchanges.
const MAX_PASSES: usize = 20;

/// Orders the selected candidates so that the largest joint motion from one to the next is small. It first goes to the nearest one each
/// time, and then reverses segments as long as that shortens the path (2-opt; Croes 1958).
pub fn short_moves(chosen: Vec<usize>, candidates: &[Vec<f64>]) -> Vec<usize> {
    let way = |a: usize, b: usize| {
        candidates[a]
            .iter()
            .zip(&candidates[b])
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max)
    };
    let mut left = chosen;
    left.sort_unstable();
    let mut order: Vec<usize> = Vec::with_capacity(left.len());
    while !left.is_empty() {
        let nearest = order.last().map_or(0, |last| {
            let distances = left
                .iter()
                .map(|candidate| way(*last, *candidate))
                .enumerate();
            distances
                .min_by(|a, b| a.1.total_cmp(&b.1))
                .map_or(0, |(i, _)| i)
        });
        order.push(left.remove(nearest));
    }
    for _ in 0..MAX_PASSES {
        let mut is_shorter = false;
        for i in 0..order.len().saturating_sub(2) {
            for j in i + 2..order.len() {
                let (a, b, c) = (order[i], order[i + 1], order[j]);
                let next = order.get(j + 1).copied();
                let before = way(a, b) + next.map_or(0.0, |d| way(c, d));
                let after = way(a, c) + next.map_or(0.0, |d| way(b, d));
                if after < before - 1e-12 {
                    order[i + 1..=j].reverse();
                    is_shorter = true;
                }
            }
        }
        if !is_shorter {
            break;
        }
    }
    order
}
