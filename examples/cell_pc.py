#!/usr/bin/env python3
"""A cell PC in Python, standard library only: upload a measurement set, have it identified, fetch the robot's active parameters.

    export KINCAL_KEY=...                                     the key, unless the server runs with --no-auth
    export KINCAL_SERVER=http://127.0.0.1:8080                the server, as for the command line; else KINCAL_URL, or --server
    cell_pc.py calibrate ROBOT_ID SET.csv [--frame base]      upload, wait for the calibration, print what came out
    cell_pc.py fetch ROBOT_ID parameters.json                 the released parameters, only if they changed, checked by their hash

Every wait is bounded. What creates something carries an Idempotency-Key, so that it may be sent again when an answer got lost.
Exit codes: 0 done, 1 failed, 2 refused: the request or the file has to be corrected.
"""

import argparse
import hashlib
import json
import os
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
import uuid
from pathlib import Path

TRIES = 5
REQUEST_TIMEOUT_S = 40
WAIT_S = 20
JOB_TIMEOUT_S = 1800


class Refused(Exception):
    """The service understood and said no; its problem document says why."""

    def __init__(self, problem):
        self.problem = problem
        reasons = "".join(f"\n  {issue['detail']}" for issue in problem.get("errors", []))
        super().__init__(f"{problem.get('detail', problem)} ({problem.get('code')}){reasons}")


class Kincal:
    def __init__(self, url, key=None):
        self.url, self.key = url.rstrip("/"), key
        # a cell's network has no proxy between this computer and the server
        self.opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))

    def send(self, method, path, body=None, content_type="application/json", headers=None):
        """One request, repeated while the network or the server is not there; (status, headers, bytes)."""
        headers = dict(headers or {})
        if self.key:
            headers["Authorization"] = f"Bearer {self.key}"
        if body is not None:
            headers["Content-Type"] = content_type
        if method == "POST":
            headers["Idempotency-Key"] = uuid.uuid4().hex
        request = urllib.request.Request(self.url + path, data=body, method=method, headers=headers)
        for attempt in range(1, TRIES + 1):
            try:
                with self.opener.open(request, timeout=REQUEST_TIMEOUT_S) as answer:
                    return answer.status, answer.headers, answer.read()
            except urllib.error.HTTPError as error:
                content = error.read()
                if error.code == 304:
                    return 304, error.headers, b""
                if error.code not in (429, 503) or attempt == TRIES:
                    raise Refused(problem_of(error.code, content)) from None
                pause = float(error.headers.get("Retry-After") or attempt)
            except OSError as error:  # no connection, or it broke
                if attempt == TRIES:
                    raise SystemExit(f"{self.url} does not answer: {error}")
                pause = attempt
            time.sleep(min(pause, 10))

    def json(self, method, path, body=None, content_type="application/json"):
        return json.loads(self.send(method, path, body, content_type)[2])

    def upload(self, robot_id, csv_path, frame):
        query = urllib.parse.urlencode({"frame": frame, "name": csv_path.stem})
        return self.json("POST", f"/v1/robots/{robot_id}/measurement-sets?{query}", csv_path.read_bytes(), "text/csv")

    def calibrate(self, robot_id, set_id):
        """Asks for a calibration and waits for its end; the job."""
        body = json.dumps({"measurement_set_id": set_id}).encode()
        job = self.json("POST", f"/v1/robots/{robot_id}/jobs", body)
        deadline = time.monotonic() + JOB_TIMEOUT_S
        while job["status"] in ("queued", "running"):
            if time.monotonic() > deadline:
                raise SystemExit(f"job {job['id']} is still {job['status']} after {JOB_TIMEOUT_S} s; ask for it later")
            # answers when the status changes, at the latest after WAIT_S
            job = self.json("GET", f"/v1/jobs/{job['id']}?wait_s={WAIT_S}")
        if job["status"] != "succeeded":
            reason = (job.get("error") or {}).get("detail", "")
            raise SystemExit(f"job {job['id']} {job['status']} {reason}".rstrip())
        return job

    def active(self, robot_id, known_etag=None):
        """The released parameter set with its ETag, or (None, ETag) if it is still the one of that ETag."""
        headers = {"If-None-Match": known_etag} if known_etag else {}
        status, answered, content = self.send("GET", f"/v1/robots/{robot_id}/parameter-sets/active", headers=headers)
        return (None if status == 304 else json.loads(content)), answered["ETag"]

    def content(self, parameter_set):
        """What the hash covers, taken only if it is whole: hash the bytes as they came, then read them."""
        content = self.send("GET", f"/v1/parameter-sets/{parameter_set['id']}/content")[2]
        found = hashlib.sha256(content).hexdigest()
        if found != parameter_set["sha256"]:
            raise SystemExit(f"parameter set {parameter_set['id']} is damaged: its SHA-256 is {found}, not {parameter_set['sha256']}")
        return json.loads(content)


def problem_of(status, content):
    try:
        return json.loads(content)
    except ValueError:
        return {"detail": f"the server answered {status}", "code": "unknown", "status": status}


def calibrate(server, arguments):
    measured = server.upload(arguments.robot, arguments.set, arguments.frame)
    for warning in measured["warnings"]:
        print(f"warning ({warning['code']}): {warning['detail']}", file=sys.stderr)
    job = server.calibrate(arguments.robot, measured["id"])
    report = server.json("GET", f"/v1/jobs/{job['id']}/report")
    for name in ("identify", "verify"):
        if report[name]:
            before, after = report[name]["before"]["rms_mm"], report[name]["after"]["rms_mm"]
            print(f"{name}: {report[name]['n_points']} points, rms {before:.4f} mm before, {after:.4f} mm after")
    for warning in report["warnings"]:
        print(f"warning ({warning['code']}): {warning['detail']}", file=sys.stderr)
    print(f"parameter set {job['parameter_set_id']} is a candidate until it is released")


def fetch(server, arguments):
    etag_file = arguments.file.with_name(arguments.file.name + ".etag")
    known = etag_file.read_text() if etag_file.exists() and arguments.file.exists() else None
    parameter_set, etag = server.active(arguments.robot, known)
    if parameter_set is None:
        print("unchanged")
        return
    content = server.content(parameter_set)
    # written beside and moved: whoever reads the file finds the old parameters or the new ones, never half of them
    part = arguments.file.with_name(arguments.file.name + ".part")
    part.write_text(json.dumps(content, indent=1))
    part.replace(arguments.file)
    etag_file.write_text(etag)
    print(f"fetched {parameter_set['id']}, released {parameter_set['released_at']}, SHA-256 {parameter_set['sha256']} checked")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    server = os.environ.get("KINCAL_SERVER") or os.environ.get("KINCAL_URL") or "http://127.0.0.1:8080"
    parser.add_argument("--server", default=server, metavar="URL")
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser("calibrate", help="upload a measurement set and have it identified")
    command.add_argument("robot", metavar="ROBOT_ID")
    command.add_argument("set", type=Path, metavar="SET.csv")
    command.add_argument("--frame", choices=["base", "instrument"], default="base")
    command.set_defaults(run=calibrate)
    command = commands.add_parser("fetch", help="fetch the released parameters if they changed")
    command.add_argument("robot", metavar="ROBOT_ID")
    command.add_argument("file", type=Path, metavar="FILE")
    command.set_defaults(run=fetch)
    arguments = parser.parse_args()
    try:
        arguments.run(Kincal(arguments.server, os.environ.get("KINCAL_KEY")), arguments)
    except Refused as refused:
        print(refused, file=sys.stderr)
        sys.exit(2 if 400 <= refused.problem.get("status", 500) < 500 else 1)
    except OSError as error:
        print(error, file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
