//! A disk that is full or read-only.

use crate::data::paper_path;
use crate::load::{body, keeps_its_promises};
use crate::process::Server;
use serde_json::json;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A small tmpfs, if the machine allows to mount one.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mount(at: &Path, mib: u32) -> Option<Self> {
        std::fs::create_dir_all(at).unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={mib}m"), "tmpfs"])
            .arg(at)
            .output();
        if mounted.is_ok_and(|output| output.status.success()) {
            return Some(Self(at.to_owned()));
        }
        let _ = writeln!(
            std::io::stderr(),
            "!!! NO FILE SYSTEM CAN BE MOUNTED HERE: THE TESTS ON FULL AND READ-ONLY DISKS DID NOT RUN !!!"
        );
        None
    }

    fn remount(&self, how: &str) {
        assert!(
            Command::new("mount")
                .args(["-o", &format!("remount,{how}")])
                .arg(&self.0)
                .status()
                .unwrap()
                .success()
        );
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").args(["-l"]).arg(&self.0).status();
    }
}

/// A robot with a released set.
pub fn released(server: &Server) -> (String, String) {
    let robot = server.robot(&paper_path("robot.json"));
    let set = server.set(&robot, &paper_path("first.csv"), "base");
    let job = server.job(
        &robot,
        &json!({"measurement_set_id": set, "method": "least_squares"}),
    );
    let parameter_set = server.finished(&job)["parameter_set_id"]
        .as_str()
        .unwrap()
        .to_owned();
    let release = format!("/v1/parameter-sets/{parameter_set}/release");
    assert_eq!(
        server
            .post(
                &release,
                "application/json",
                br#"{"reason": "first"}"#.to_vec()
            )
            .0,
        200
    );
    (robot, parameter_set)
}

pub fn upload(server: &Server, robot: &str, serial: usize) -> (u16, serde_json::Value) {
    server.post(
        &format!("/v1/robots/{robot}/measurement-sets?frame=base"),
        "text/csv",
        body(serial).into_bytes(),
    )
}

pub fn active(server: &Server, robot: &str) -> u16 {
    server
        .get(&format!("/v1/robots/{robot}/parameter-sets/active"))
        .0
}

#[test]
fn a_full_disk_refuses_uploads_before_it_is_full_and_recovers_without_a_restart() {
    let dir = tempfile::tempdir().unwrap();
    let Some(disk) = SmallDisk::mount(&dir.path().join("small"), 96) else {
        return;
    };
    let data_dir = disk.0.join("data");
    let server = Server::start(&data_dir, 1);
    let (robot, parameter_set) = released(&server);
    let filler = disk.0.join("filler");
    std::fs::write(&filler, vec![1_u8; 40 << 20]).unwrap();
    let (status, problem) = upload(&server, &robot, 1);
    assert_eq!(
        (status, problem["code"].as_str()),
        (507, Some("no_room")),
        "{problem}"
    );
    assert_eq!(active(&server, &robot), 200);
    let ready = server.text("/readyz");
    assert!(
        ready.starts_with("ready, but") && ready.contains("left on the disk"),
        "{ready}"
    );
    // Fills the disk to its last byte: each failed write gets an error answer, and none is half done.
    let mut file = std::fs::File::options().append(true).open(&filler).unwrap();
    while file.write_all(&[1_u8; 4096]).is_ok() {}
    assert!(matches!(upload(&server, &robot, 2).0, 503 | 507));
    assert_eq!(active(&server, &robot), 200);
    let withdraw = format!("/v1/parameter-sets/{parameter_set}/withdraw");
    let (status, answer) = server.post(
        &withdraw,
        "application/json",
        br#"{"reason": "wrong"}"#.to_vec(),
    );
    assert!(matches!(status, 200 | 503), "{status} {answer}");
    drop(file);
    std::fs::remove_file(&filler).unwrap();
    let (status, answer) = upload(&server, &robot, 3);
    assert_eq!(
        status, 201,
        "with room again it goes on, without a restart: {answer}"
    );
    assert!(server.terminate().0.success());
    keeps_its_promises(&data_dir);
}

#[test]
fn a_disk_that_turns_read_only_still_answers_what_was_released() {
    let dir = tempfile::tempdir().unwrap();
    let Some(disk) = SmallDisk::mount(&dir.path().join("small"), 256) else {
        return;
    };
    let data_dir = disk.0.join("data");
    let server = Server::start(&data_dir, 1);
    let (robot, _) = released(&server);
    // The kernel refuses to remount while files are open for writing. Immutable files have the same effect for the server.
    let busy = !Command::new("mount")
        .args(["-o", "remount,ro"])
        .arg(&disk.0)
        .status()
        .unwrap()
        .success();
    if busy {
        // A disk without free space cannot be written either.
        let filler = std::fs::File::create(disk.0.join("filler")).unwrap();
        let mut filler = std::io::BufWriter::new(filler);
        while filler.write_all(&[1_u8; 4096]).is_ok() {}
        let _ = filler.into_parts();
    }
    assert_eq!(active(&server, &robot), 200);
    let (status, problem) = upload(&server, &robot, 1);
    assert!(matches!(status, 503 | 507), "{status} {problem}");
    if busy {
        std::fs::remove_file(disk.0.join("filler")).unwrap();
    } else {
        disk.remount("rw");
    }
    assert_eq!(upload(&server, &robot, 2).0, 201);
    assert!(server.terminate().0.success());
    keeps_its_promises(&data_dir);
}
