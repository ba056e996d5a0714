//! The distal (standard) Denavit-Hartenberg convention: A_i = Rz(q + theta)·Dz(d)·Dx(a)·Rx(alpha).

use crate::exchange::links::ImportedLinks;
use crate::kinematics::Link;
use crate::kinematics::forward::t_previous_link;
use nalgebra::IsometryMatrix3;

/// Links of a distal table. Its row i has theta and d of link i, and a and alpha of the *next* link in Craig's convention. a and alpha of the last
/// row come after the last axis, where there is no link; they become the flange's pose on the last link.
pub fn links_of_distal(rows: &[Link]) -> ImportedLinks {
    let before = |i: usize| if i == 0 { Link::default() } else { rows[i - 1] };
    let link = |(i, row): (usize, &Link)| Link {
        a_mm: before(i).a_mm,
        alpha_rad: before(i).alpha_rad,
        d_mm: row.d_mm,
        theta_offset_rad: row.theta_offset_rad,
        beta_rad: 0.0,
    };
    let behind = rows.last().map_or_else(Link::default, |row| Link {
        d_mm: 0.0,
        theta_offset_rad: 0.0,
        ..*row
    });
    ImportedLinks {
        t_root_base: IsometryMatrix3::identity(),
        links: rows.iter().enumerate().map(link).collect(),
        t_flange_tip: t_previous_link(&behind, 0.0),
    }
}
