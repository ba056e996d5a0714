//! Particles, their search box, and an option for every choice that the paper leaves open.

/// Positions of a swarm, coordinate-major: all particles' first coordinate, then all particles' second, …
#[derive(Clone, Debug, PartialEq)]
pub struct Positions {
    /// Number of particles.
    pub n_particles: usize,
    /// Number of coordinates of each.
    pub n_coordinates: usize,
    /// Coordinate j of particle i is `values[j * n_particles + i]`.
    pub values: Vec<f64>,
}

impl Positions {
    /// All zero.
    pub fn zeros(n_particles: usize, n_coordinates: usize) -> Self {
        Self {
            n_particles,
            n_coordinates,
            values: vec![0.0; n_particles * n_coordinates],
        }
    }

    /// Coordinate j of all particles.
    pub fn coordinate(&self, j: usize) -> &[f64] {
        &self.values[j * self.n_particles..(j + 1) * self.n_particles]
    }

    /// Coordinate j of all particles, mutable.
    pub fn coordinate_mut(&mut self, j: usize) -> &mut [f64] {
        &mut self.values[j * self.n_particles..(j + 1) * self.n_particles]
    }

    /// Coordinate j of particle i.
    pub fn get(&self, i: usize, j: usize) -> f64 {
        self.coordinate(j)[i]
    }

    /// Sets coordinate j of particle i.
    pub fn set(&mut self, i: usize, j: usize, value: f64) {
        self.coordinate_mut(j)[i] = value;
    }

    /// All coordinates of particle i, gathered.
    pub fn particle(&self, i: usize) -> Vec<f64> {
        (0..self.n_coordinates).map(|j| self.get(i, j)).collect()
    }

    /// Sets all coordinates of particle i.
    ///
    /// # Panics
    /// When `position` has another number of coordinates.
    pub fn set_particle(&mut self, i: usize, position: &[f64]) {
        assert_eq!(
            position.len(),
            self.n_coordinates,
            "one value per coordinate"
        );
        for (j, &value) in position.iter().enumerate() {
            self.set(i, j, value);
        }
    }
}

/// The box in which the first positions are drawn, uniformly: centre ± half width. The swarm may leave it.
#[derive(Clone, Debug, PartialEq)]
pub struct SearchBox {
    /// Centre, one value per coordinate.
    pub centre: Vec<f64>,
    /// Half width, one value per coordinate, not negative.
    pub half_width: Vec<f64>,
}

/// Options of the search. The default is the closest reading of the paper. The paper prints neither first velocities nor a limit of velocities or
/// positions: first velocities are zero, and nothing is limited. Nor does it print how r1 and r2 are drawn: separately for every coordinate of every
/// particle, the usual reading of the formula.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Number of particles n: 200 [Gao 2018, section 3.1].
    pub n_particles: usize,
    /// Maximum number of swarm updates: 492, as in the paper's experiment [Gao 2018, section 4].
    pub n_iterations: usize,
    /// Inertia weight w: 0.9 [Gao 2018, eq. 9].
    pub inertia_weight: f64,
    /// Cognitive factor c1, the attraction to the particle's own best: 0.5 [Gao 2018, eq. 9].
    pub cognitive: f64,
    /// Social factor c2, the attraction to the swarm's best: 1.25 [Gao 2018, eq. 9].
    pub social: f64,
    /// Stops as soon as the best cost is at or below this: never (not printed).
    pub stop_at_cost: Option<f64>,
    /// Seed of all random numbers: 0.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            n_particles: 200,
            n_iterations: 492,
            inertia_weight: 0.9,
            cognitive: 0.5,
            social: 1.25,
            stop_at_cost: None,
            seed: 0,
        }
    }
}

/// Computes the cost of all positions at once, one per particle. A cost that is not finite counts as +∞. On entry, `costs` has each particle's own
/// best cost so far. A cost that is not below it may be left incomplete, with any value that is not below it either.
pub type Cost<'a> = dyn FnMut(&Positions, &mut [f64]) + 'a;
