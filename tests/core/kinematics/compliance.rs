//! Forward kinematics with corrections, compared with numpy (docs/oracles/compliance_forward.py) and with the rigid kinematics.

use kincal::kinematics::compliance::{moments, rigid_chain, t_base_flange_corrected};
use kincal::kinematics::corrections::usual_masses;
use kincal::kinematics::{
    Compliance, Corrections, Harmonic, Link, Mounting, Payload, ResidualNetwork, t_base_flange,
};
use nalgebra::{Matrix3, Vector3};

const ORACLE: &str = include_str!("../../../docs/oracles/compliance_forward.csv");

/// Takes numbers from the front of a line.
struct Numbers(std::vec::IntoIter<f64>);

impl Numbers {
    fn take(&mut self, n: usize) -> Vec<f64> {
        self.0.by_ref().take(n).collect()
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::from_vec(self.take(3))
    }

    fn vectors(&mut self, n: usize) -> Vec<Vector3<f64>> {
        (0..n).map(|_| self.vector()).collect()
    }
}

struct Case {
    links: Vec<Link>,
    q_rad: Vec<f64>,
    corrections: Corrections,
    rotation: Matrix3<f64>,
    translation_mm: Vector3<f64>,
}

fn case(line: &str) -> Case {
    let mut numbers = Numbers(
        line.split(',')
            .map(|v| v.parse().unwrap())
            .collect::<Vec<f64>>()
            .into_iter(),
    );
    let n = numbers.take(1)[0] as usize;
    let link = |v: Vec<f64>| Link {
        a_mm: v[0],
        alpha_rad: v[1],
        d_mm: v[2],
        theta_offset_rad: v[3],
        beta_rad: v[4],
    };
    let links = (0..n).map(|_| link(numbers.take(5))).collect();
    let q_rad = numbers.take(n);
    let (gravity_in_base, masses, first_moments_m) =
        (numbers.vector(), numbers.take(n), numbers.vectors(n));
    let (joints_rad, base_rad) = (numbers.vectors(n), numbers.vector());
    let joint_coupling = (0..n).map(|_| numbers.take(n)).collect();
    let harmonics = (0..n)
        .map(|_| {
            numbers
                .take(4)
                .chunks(2)
                .map(|h| Harmonic {
                    sin_rad: h[0],
                    cos_rad: h[1],
                })
                .collect()
        })
        .collect();
    let mass_unit_kg = 10.0;
    let payload = Some(Payload {
        mass_kg: numbers.take(1)[0] * mass_unit_kg,
        centre_mm: numbers.vector(),
    });
    let compliance = Compliance {
        gravity_in_base,
        masses,
        first_moments_m,
        joints_rad,
        base_rad,
        payload,
        mass_unit_kg,
    };
    let rotation = Matrix3::from_row_slice(&numbers.take(9));
    let translation_mm = numbers.vector();
    assert!(numbers.0.next().is_none());
    Case {
        links,
        q_rad,
        corrections: Corrections {
            compliance,
            joint_coupling,
            harmonics,
            residual: None,
        },
        rotation,
        translation_mm,
    }
}

fn floor() -> Mounting {
    Mounting {
        gravity_in_base: -Vector3::z(),
        std_rad: 0.035,
    }
}

#[test]
fn the_corrected_flange_is_numpys_to_a_picometre() {
    let mut bent_mm = 0.0f64;
    for case in ORACLE.lines().map(case) {
        let flange = t_base_flange_corrected(&case.links, &case.corrections, &case.q_rad);
        assert!(
            (flange.translation.vector - case.translation_mm).norm() < 1e-9,
            "{}",
            flange.translation.vector - case.translation_mm
        );
        assert!((flange.rotation.matrix() - case.rotation).norm() < 1e-12);
        let rigid = t_base_flange(&case.links, &case.q_rad);
        bent_mm = bent_mm.max((rigid.translation.vector - case.translation_mm).norm());
    }
    // The corrections of the cases have an effect.
    assert!(bent_mm > 1.0, "{bent_mm}");
}

#[test]
fn without_corrections_nothing_changes_not_even_a_bit() {
    for case in ORACLE.lines().map(case) {
        let none = Corrections::none(case.links.len(), &floor());
        assert_eq!(
            t_base_flange_corrected(&case.links, &none, &case.q_rad),
            t_base_flange(&case.links, &case.q_rad)
        );
    }
}

#[test]
fn a_level_lever_has_the_moment_of_its_mass() {
    // One joint about a horizontal axis, and a mass of 2 units at 0.5 m along x: gravity along -z turns it about +y.
    let links = [
        Link::default(),
        Link {
            a_mm: 500.0,
            ..Link::default()
        },
    ];
    let mut corrections = Corrections::none(2, &floor());
    corrections.compliance.masses = vec![0.0, 2.0];
    let chain = rigid_chain(&links, &[0.0, 0.0]);
    let moments = moments(&chain, &corrections.compliance);
    assert!(
        (moments.base - Vector3::new(0.0, 1.0, 0.0)).norm() < 1e-15,
        "{}",
        moments.base
    );
    assert!((moments.joints[0] - Vector3::new(0.0, 1.0, 0.0)).norm() < 1e-15);
    assert!(moments.joints[1].norm() < 1e-15);
    // With a base compliance of 1 mrad per unit the tip sinks by 0.5 mm.
    corrections.compliance.base_rad = Vector3::new(0.0, 1e-3, 0.0);
    let tip = t_base_flange_corrected(&links, &corrections, &[0.0, 0.0])
        .translation
        .vector;
    assert!((tip.z + 500.0 * 1e-3f64.sin()).abs() < 1e-12, "{tip}");
}

#[test]
fn the_residual_network_is_its_formula() {
    let network = ResidualNetwork {
        centre_rad: vec![0.1, -0.2],
        half_range_rad: vec![0.5, 2.0],
        hidden_weights: vec![0.3, -0.4],
        hidden_thresholds: vec![0.05],
        output_weights: vec![1.0, -2.0, 0.5],
        output_thresholds: vec![0.0, 0.1, 0.2],
        scale_mm: 0.3,
    };
    let hidden = (0.3 * (0.6 - 0.1) / 0.5 - 0.4 * (1.0 + 0.2) / 2.0 - 0.05f64).tanh();
    let expected = Vector3::new(hidden, -2.0 * hidden - 0.1, 0.5 * hidden - 0.2) * 0.3;
    assert!((network.displacement_mm(&[0.6, 1.0]) - expected).norm() < 1e-15);
    let links = [Link {
        a_mm: 100.0,
        ..Link::default()
    }; 2];
    let with = Corrections {
        residual: Some(network),
        ..Corrections::none(2, &floor())
    };
    let moved = t_base_flange_corrected(&links, &with, &[0.6, 1.0])
        .translation
        .vector
        - t_base_flange(&links, &[0.6, 1.0]).translation.vector;
    assert!((moved - expected).norm() < 1e-12);
}

#[test]
fn masses_start_at_elbow_wrist_and_flange() {
    assert_eq!(usual_masses(6), [0.0, 0.0, 1.0, 0.0, 1.0, 0.5]);
    assert_eq!(usual_masses(7), [0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.5]);
    assert_eq!(usual_masses(4), [0.0, 0.0, 2.0, 0.5]);
    assert_eq!(usual_masses(2), [1.0, 1.5]);
    assert_eq!(usual_masses(1), [2.5]);
}
