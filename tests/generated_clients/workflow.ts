// The whole workflow by the types that openapi-typescript makes: robot, upload, job, wait, report, release.

import { readFileSync } from "node:fs";
import createClient from "openapi-fetch";
import type { components, paths } from "./contract.js";

type Shapes = components["schemas"];

function need<T>(answer: { data?: T; error?: unknown }): T {
  if (answer.data === undefined) throw new Error(JSON.stringify(answer.error));
  return answer.data;
}

const [robotFile, setFile] = process.argv.slice(2) as [string, string];
const client = createClient<paths>({ baseUrl: process.env["KINCAL_URL"] ?? "" });

const robotBody = JSON.parse(readFileSync(robotFile, "utf8")) as Shapes["RobotBody"];
const robot = need(await client.POST("/v1/robots", { body: robotBody }));
const ofRobot = { path: { robot_id: robot.id } };
const edited = need(await client.PATCH("/v1/robots/{robot_id}", { params: ofRobot, body: { name: "TypeScript's" } }));
if (edited.name !== "TypeScript's") throw new Error(JSON.stringify(edited));

const [header = "", ...rows] = readFileSync(setFile, "utf8").trim().split(/\r?\n/);
const columns = header.split(",");
const points = rows.map((line): Shapes["PointBody"] => {
  const cells = line.split(",");
  const number = (name: string): number => Number(cells[columns.indexOf(name)]);
  const joints = columns.filter((name) => /^q\d+_deg$/.test(name)).sort();
  const subset = cells[columns.indexOf("subset")];
  const point: Shapes["PointBody"] = {
    q_deg: joints.map(number),
    position_mm: [number("x_mm"), number("y_mm"), number("z_mm")],
  };
  if (subset === "identify" || subset === "verify") point.subset = subset;
  return point;
});
const uploaded = need(
  await client.POST("/v1/robots/{robot_id}/measurement-sets", { params: ofRobot, body: { frame: "base", points } }),
);

const request: Shapes["JobRequestBody"] = { measurement_set_id: uploaded.id, method: "least_squares" };
let job = need(await client.POST("/v1/robots/{robot_id}/jobs", { params: ofRobot, body: request }));
while (job.status === "queued" || job.status === "running") {
  job = need(await client.GET("/v1/jobs/{id}", { params: { path: { id: job.id }, query: { wait_s: 20 } } }));
}
if (job.status !== "succeeded" || !job.parameter_set_id) throw new Error(JSON.stringify(job));

const report = need(await client.GET("/v1/jobs/{id}/report", { params: { path: { id: job.id } } }));
const released = need(
  await client.POST("/v1/parameter-sets/{id}/release", {
    params: { path: { id: job.parameter_set_id } },
    body: { reason: "a test of the generated client" },
  }),
);
const active = need(await client.GET("/v1/robots/{robot_id}/parameter-sets/active", { params: ofRobot }));
if (active.id !== released.id) throw new Error(JSON.stringify(active));
console.log(`TypeScript: ${released.id} is ${released.status}, verify rms ${report.verify?.after.rms_mm.toFixed(4)} mm`);
