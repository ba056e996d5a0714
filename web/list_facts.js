// What the list of robots asks beside the overview: how far a newer result is from the active set, whether a release would be refused, and the error of a
// session that does not fit. Each is asked once, two at a time, after the list is there.

import { each, get } from "./api.js";
import { SOON_JUDGED } from "./next.js";

/** Requests at once: each is some work for the service. */
const AT_ONCE = 2;

/** Places for the answers, by the robot; null stands for one that is on its way. */
export const noFacts = () => ({ drifts: new Map(), judged: new Map(), checks: new Map() });

/** Forgets the answers about robots whose sets or need have changed since the list was asked for. */
export function forget(before, now, state) {
  const about = ({ newest, active, need, need_job_id }) => [newest?.id, newest?.status, active?.id, need, need_job_id].join();
  const known = new Map(before.map((robot) => [robot.robot_id, about(robot)]));
  const changed = now.filter((robot) => known.get(robot.robot_id) !== about(robot));
  for (const { robot_id: id } of changed) for (const answers of [state.drifts, state.judged, state.checks]) answers.delete(id);
}

/** Whether a newer result than the active set waits. */
export const isNewer = ({ active, newest }) => active !== undefined && newest !== undefined && newest.id !== active.id && newest.created_at > active.created_at;

/** Whether the newest result may still be released, and nothing else has to be done before. */
function isOpen({ need, newest, active }) {
  const isOlder = active !== undefined && newest !== undefined && newest.created_at < active.created_at;
  return newest?.status === "candidate" && need !== "check_robot" && !isOlder;
}

/** The gates that refuse a release of the newest result: by what is stored, else by all gates once they were asked, as on the robot's own page. */
export function refusals(robot, { judged }) {
  if (!isOpen(robot)) return [];
  return judged.get(robot.robot_id)?.refused ?? (robot.newest.refused_by ? [robot.newest.refused_by] : []);
}

/** Whether the robot has drifted: a session speaks against the active set, or the points of a newer result do. */
export const hasDrifted = (robot, { judged }) => robot.need === "drifted" || (isNewer(robot) && Boolean(judged.get(robot.robot_id)?.refused.includes("change_plausible")));

/** Asks what is not known yet of these robots; `came` is called with each robot of which something came. Whether anything was new. */
export async function learn(robots, state, signal, came) {
  const asked = await Promise.all([
    ask(robots.filter(isNewer), state.drifts, (robot) => get(`/v1/parameter-sets/${robot.newest.id}/compare?with=${robot.active.id}`, signal), came),
    ask(robots.filter((robot) => isOpen(robot) && (isNewer(robot) || !robot.newest.refused_by) && (robot.newest.n_points ?? 0) <= SOON_JUDGED), state.judged, async (robot) => {
      const { gates } = await get(`/v1/parameter-sets/${robot.newest.id}/gates`, signal);
      return { refused: gates.filter((gate) => !gate.passed).map(({ gate }) => gate) };
    }, came),
    ask(robots.filter((robot) => robot.need === "check_robot" && robot.need_job_id), state.checks, async (robot) => {
      const job = await get(`/v1/jobs/${robot.need_job_id}`, signal);
      const set = job.measurement_set_id && await get(`/v1/measurement-sets/${job.measurement_set_id}`, signal).catch(() => undefined);
      return { ...job, measured_at: set?.record?.measured_at };
    }, came)]);
  return asked.some(Boolean);
}

async function ask(robots, answers, question, came) {
  const open = robots.filter((robot) => !answers.has(robot.robot_id));
  for (const robot of open) answers.set(robot.robot_id, null);
  await each(open, async (robot) => {
    answers.set(robot.robot_id, await question(robot).catch(() => undefined));
    came(robot);
  }, AT_ONCE);
  return open.length > 0;
}
