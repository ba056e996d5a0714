//! What all points of one arm configuration share: Z with B = Z·Zᵀ, three columns (one per axis) for each configuration of several
//! points, the points' sqrt(weight) in its rows. Kept as lists of rows: as a matrix it would grow with the square of the points.

use crate::identification::objective::Observation;
use nalgebra::DMatrix;

/// Z. Its columns are orthogonal, since a point belongs to one configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Shared {
    /// Of each configuration of several points: the points, and the roots of their weights.
    blocks: Vec<Vec<(usize, f64)>>,
    n_points: usize,
}

impl Shared {
    /// `clusters` numbers each observation's configuration.
    pub fn new(observations: &[Observation], clusters: &[usize]) -> Self {
        let n_clusters = clusters.iter().map(|c| c + 1).max().unwrap_or(0);
        let mut blocks = vec![vec![]; n_clusters];
        for (point, (o, cluster)) in observations.iter().zip(clusters).enumerate() {
            blocks[*cluster].push((point, o.weight.sqrt()));
        }
        blocks.retain(|block: &Vec<(usize, f64)>| block.len() > 1);
        Self {
            blocks,
            n_points: observations.len(),
        }
    }

    /// Columns of Z.
    pub fn ncols(&self) -> usize {
        3 * self.blocks.len()
    }

    /// Squared length of each column.
    pub fn squared_lengths(&self) -> Vec<f64> {
        let squared =
            |block: &Vec<(usize, f64)>| block.iter().map(|(_, root)| root * root).sum::<f64>();
        self.blocks
            .iter()
            .flat_map(|block| [squared(block); 3])
            .collect()
    }

    /// Zᵀ·m, of 3·N rows.
    pub fn transpose_times(&self, m: &DMatrix<f64>) -> DMatrix<f64> {
        let sum = |row: usize, column: usize| -> f64 {
            self.blocks[row / 3]
                .iter()
                .map(|(point, root)| root * m[(3 * point + row % 3, column)])
                .sum()
        };
        DMatrix::from_fn(self.ncols(), m.ncols(), sum)
    }

    /// Z·m, of one row per column of Z.
    pub fn times(&self, m: &DMatrix<f64>) -> DMatrix<f64> {
        let mut product = DMatrix::zeros(3 * self.n_points, m.ncols());
        for (k, block) in self.blocks.iter().enumerate() {
            for (point, root) in block {
                for axis in 0..3 {
                    product
                        .row_mut(3 * point + axis)
                        .copy_from(&(m.row(3 * k + axis) * *root));
                }
            }
        }
        product
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// Z written out, to compare with.
    fn dense(observations: &[Observation], clusters: &[usize]) -> DMatrix<f64> {
        let several: Vec<usize> = (0..4)
            .filter(|c| clusters.iter().filter(|d| *d == c).count() > 1)
            .collect();
        DMatrix::from_fn(3 * observations.len(), 3 * several.len(), |row, column| {
            let belongs = clusters[row / 3] == several[column / 3] && row % 3 == column % 3;
            if belongs {
                observations[row / 3].weight.sqrt()
            } else {
                0.0
            }
        })
    }

    #[test]
    fn the_lists_multiply_as_the_matrix_that_they_stand_for() {
        let clusters = [0, 1, 0, 2, 3, 3, 0];
        let observation = |i: usize| Observation {
            q_rad: vec![],
            position_mm: Vector3::zeros(),
            target: 0,
            weight: 1.0 + i as f64,
        };
        let observations: Vec<Observation> = (0..clusters.len()).map(observation).collect();
        let (z, shared) = (
            dense(&observations, &clusters),
            Shared::new(&observations, &clusters),
        );
        let m = DMatrix::from_fn(21, 2, |row, column| libm::sin((3 * row + column) as f64));
        let k = DMatrix::from_fn(6, 2, |row, column| libm::cos((row + 5 * column) as f64));
        assert_eq!((shared.ncols(), z.ncols()), (6, 6));
        // sums of at most three products
        assert!((shared.transpose_times(&m) - z.transpose() * &m).amax() < 1e-14);
        assert!((shared.times(&k) - &z * &k).amax() < 1e-14);
        let lengths: Vec<f64> = z
            .column_iter()
            .map(|column| column.norm_squared())
            .collect();
        assert!(
            shared
                .squared_lengths()
                .iter()
                .zip(lengths)
                .all(|(a, b)| (a - b).abs() < 1e-13)
        );
    }
}
