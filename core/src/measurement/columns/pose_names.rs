//! Names under which controllers write a pose next to joint values: X, Y, Z and three numbers of a rotation.

use crate::measurement::columns::names::PLAIN;

/// Names of the numbers of a rotation: KUKA (A, B, C), FANUC (W, P, R), Universal Robots, Stäubli and Yaskawa (Rx, Ry, Rz), Kawasaki (O, A, T), Epson
/// (U, V, W), and roll, pitch and yaw.
const ROTATIONS: [[&str; 3]; 6] = [
    ["a", "b", "c"],
    ["w", "p", "r"],
    ["rx", "ry", "rz"],
    ["o", "a", "t"],
    ["u", "v", "w"],
    ["roll", "pitch", "yaw"],
];
/// Words next to such a name that do not change its meaning.
const IGNORED_WORDS: [&str; 5] = ["tcp", "actual", "pose", "rot", "tool"];

/// The name of a column without its unit and without words that do not change its meaning; empty for the names of kincal's file format.
fn bare(name: &str) -> String {
    let lower = name.trim().to_lowercase();
    if PLAIN.contains(&lower.as_str()) {
        return String::new();
    }
    let end = lower.find(['[', '(', '{', '（']).unwrap_or(lower.len());
    let words = lower[..end].split(|c: char| !c.is_alphanumeric());
    let units = ["mm", "m", "deg", "rad"];
    let own =
        |word: &&str| !word.is_empty() && !IGNORED_WORDS.contains(word) && !units.contains(word);
    words.filter(own).collect::<Vec<_>>().join(" ")
}

/// The columns of a rotation as controllers write it, if a header has all three, such as `Rx [rad]`, `Ry [rad]` and `Rz [rad]`.
pub fn rotation_columns(header: &[String]) -> Option<[usize; 3]> {
    let bare: Vec<String> = header.iter().map(|name| bare(name)).collect();
    let place = |wanted: &str| bare.iter().position(|name| name == wanted);
    ROTATIONS.into_iter().find_map(|names| {
        let places: Option<Vec<usize>> = names.into_iter().map(place).collect();
        places?.try_into().ok()
    })
}

/// The columns of a pose: X, Y and Z, and a rotation if there is one.
pub fn pose_columns(header: &[String]) -> Vec<usize> {
    let axis = |wanted: &str| header.iter().position(|name| bare(name) == wanted);
    let axes: Option<Vec<usize>> = ["x", "y", "z"].into_iter().map(axis).collect();
    axes.map_or(vec![], |mut places| {
        places.extend(rotation_columns(header).into_iter().flatten());
        places
    })
}

#[cfg(test)]
mod tests {
    use super::{pose_columns, rotation_columns};

    fn header(names: &str) -> Vec<String> {
        names.split(',').map(str::to_owned).collect()
    }

    #[test]
    fn poses_of_controllers_are_known_by_their_names() {
        for names in [
            "X,Y,Z,A,B,C",
            "X [mm],Y [mm],Z [mm],W [deg],P [deg],R [deg]",
            "x (m),y (m),z (m),Rx (rad),Ry (rad),Rz (rad)",
            "X,Y,Z,O,A,T",
            "TCP X [mm],TCP Y [mm],TCP Z [mm],Roll,Pitch,Yaw",
        ] {
            assert_eq!(rotation_columns(&header(names)), Some([3, 4, 5]), "{names}");
            assert_eq!(pose_columns(&header(names)), [0, 1, 2, 3, 4, 5], "{names}");
        }
        for names in ["S,L,U,R,B,T,X,Y,Z", "x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg"] {
            assert_eq!(rotation_columns(&header(names)), None, "{names}");
        }
    }
}
