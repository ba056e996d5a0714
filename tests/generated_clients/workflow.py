"""The whole workflow by the client that openapi-python-client makes: robot, upload, job, wait, report, release."""

import csv
import io
import json
import os
import sys

from kincal_client import Client
from kincal_client.api.jobs import create_job, get_job, get_report
from kincal_client.api.measurement_sets import create_measurement_set
from kincal_client.api.parameter_sets import get_active_parameter_set, release_parameter_set
from kincal_client.api.robots import create_robot, edit_robot
from kincal_client.models import (
    JobRequestBody,
    MeasurementSetBody,
    ReleaseBody,
    RobotBody,
    RobotPatchBody,
    UploadForm,
)
from kincal_client.types import File


def need(answer, kind):
    assert type(answer).__name__ == kind, f"{kind} is expected, and this came: {answer}"
    return answer


robot_file, set_file = sys.argv[1:]
client = Client(base_url=os.environ["KINCAL_URL"])

with open(robot_file) as file:
    body = RobotBody.from_dict(json.load(file))
robot = need(create_robot.sync(client=client, body=body), "RobotAnswer")
patch = RobotPatchBody.from_dict({"name": "Python's"})
assert edit_robot.sync(robot.id, client=client, body=patch).name == "Python's"

with open(set_file, newline="") as file:
    points = []
    for row in csv.DictReader(file):
        n = sum(name.startswith("q") for name in row)
        point = {
            "q_deg": [float(row[f"q{joint + 1}_deg"]) for joint in range(n)],
            "position_mm": [float(row[axis]) for axis in ("x_mm", "y_mm", "z_mm")],
        }
        if row.get("subset"):
            point["subset"] = row["subset"]
        points.append(point)
body = MeasurementSetBody.from_dict({"frame": "base", "points": points})
uploaded = need(create_measurement_set.sync(robot.id, client=client, body=body), "SetSummary")

# the same points as two files, which are joined by the points' names
joints = "\n".join(f"P{i}," + ",".join(map(str, point["q_deg"])) for i, point in enumerate(points))
positions = "\n".join(f"P{i}," + ",".join(map(str, point["position_mm"])) for i, point in enumerate(points))
log = "Point," + ",".join(f"J{joint + 1} [deg]" for joint in range(n)) + "\n" + joints
form = UploadForm(
    robot=File(payload=io.BytesIO(log.encode()), file_name="log.csv"),
    instrument=File(payload=io.BytesIO(b"Name,X [mm],Y [mm],Z [mm]\n" + positions.encode()), file_name="export.csv"),
)
joined = create_measurement_set.sync(robot.id, client=client, body=form, idempotency_key="two-files")
joined = need(joined, "SetSummary")
assert joined.joined.join.n_joined == len(points), joined

request = {"measurement_set_id": uploaded.id, "method": "least_squares"}
body = JobRequestBody.from_dict(request)
job = need(create_job.sync(robot.id, client=client, body=body), "JobAnswer")
while str(job.status.value) in ("queued", "running"):
    job = need(get_job.sync(job.id, client=client.with_timeout(60), wait_s=20), "JobAnswer")
assert job.status.value == "succeeded", job

report = need(get_report.sync(job.id, client=client), "Report")
body = ReleaseBody(reason="a test of the generated client")
released = release_parameter_set.sync(job.parameter_set_id, client=client, body=body)
released = need(released, "ParameterSetAnswer")
active = need(get_active_parameter_set.sync(robot.id, client=client), "ParameterSetAnswer")
assert active.id == released.id
print(f"Python: {released.id} is {released.status.value}, verify rms {report.verify.after.rms_mm:.4f} mm")
