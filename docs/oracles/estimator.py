"""Two estimators of links to compare with: scipy's unregularised least squares, and maximum a posteriori in numpy, on the same splits.

    python docs/oracles/estimator.py REFERENCE REAL OUT [FIRST_SEED] > docs/oracles/estimator.csv

REFERENCE is the folder with split.py, odd_robots.py, scipy_fit.py and map_identify.py, REAL the folder with the measured sets.
OUT gets a folder for each case, with robot.json and set.csv; `examples/study/estimator.rs` reads them. With FIRST_SEED only the
simulated robots of that seed and the next are made.
"""
import csv
import json
import pathlib
import shutil
import subprocess
import sys

SPLITS = range(8)
DRAWS = range(8)
FEW = 15


def write(path, rows):
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def case(out, name, robot):
    folder = out / name
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(robot, folder / "robot.json")
    return folder / "set.csv"


def few_configurations(path, seed, to):
    """FEW random configurations to identify from, all others to verify."""
    import numpy as np

    rows = list(csv.DictReader(open(path)))
    all_configurations = sorted({r["configuration"] for r in rows})
    chosen = set(np.random.default_rng([seed, FEW]).choice(all_configurations, FEW, replace=False))
    for row in rows:
        row["subset"] = "identify" if row["configuration"] in chosen else "verify"
    write(to, rows)


def make_real(reference, real, out):
    sets = [("qkm_hl6", "set"), ("motoman_ma1400", "visit_1"), ("motoman_ma1400", "visit_2")]
    for folder, file in sets:
        robot, path = real / folder / "robot.json", real / folder / f"{file}.csv"
        for seed in SPLITS:
            to = case(out, f"{folder}.{file}.split.{seed}", robot)
            subprocess.run([sys.executable, reference / "split.py", path, str(seed), to], check=True)
        for draw in DRAWS if file != "visit_2" else []:
            few_configurations(path, draw, case(out, f"{folder}.{file}.few.{draw}", robot))
    for arm in "BD":
        rows = list(csv.DictReader(open(real / "ur10_tmac" / f"data_{arm}.csv")))
        keep = [k for k in rows[0] if not k.startswith(("std_", "r", "temperature"))]
        to = case(out, f"ur10_tmac.{arm}.column.0", real / "ur10_tmac" / "robot.json")
        write(to, [{k: r[k] for k in keep} for r in rows])


def make_simulated(reference, out, first_seed):
    made = out / "simulated"
    subprocess.run([sys.executable, reference / "odd_robots.py", made, str(first_seed)], check=True)
    for folder in sorted(made.iterdir()):
        name, seed = folder.name.rsplit("_", 1)
        shutil.copy(folder / "set.csv", case(out, f"odd.{name}.seed.{seed}", folder / "robot.json"))
    shutil.rmtree(made)


def main(reference, real, out, first_seed=None):
    reference, real, out = (pathlib.Path(p) for p in (reference, real, out))
    sys.path.insert(0, str(reference))
    import map_identify
    import scipy_fit

    if first_seed is None:
        make_real(reference, real, out)
    make_simulated(reference, out, first_seed or 10000)
    print("case,scipy_rms_mm,map_rms_mm")
    for folder in sorted(out.iterdir()):
        files = (str(folder / "robot.json"), str(folder / "set.csv"))
        scipy, map_ = (m.main(*files)["verify_rms_mm"] for m in (scipy_fit, map_identify))
        print(f"{folder.name},{scipy},{map_}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
