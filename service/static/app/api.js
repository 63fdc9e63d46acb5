/** The service's HTTP API, as the page needs it. */

import { askForKey, withKey } from "./key.js";
import { eventsOf } from "./sse.js";

/** Rejected request, with its problem document (RFC 9457). */
export class ServiceProblem extends Error {
  /**
   * @param {{title: string, detail: string, status: number, field?: string, value?: unknown,
   *   expected?: string, errors?: object[]}} problem
   * @param {number | null} retryAfterS seconds of the header Retry-After
   */
  constructor(problem, retryAfterS = null) {
    super(problem.detail);
    this.problem = problem;
    this.retryAfterS = retryAfterS;
  }
}

/** The service cannot be reached, or went away in the middle of an answer. */
export class LostService extends Error {}

/** Address of a path of the API, wherever the service is mounted. */
export function address(path) {
  return new URL(path, document.baseURI).href;
}

/** @returns {Promise<string>} "ready", "loading", ... or "lost" */
export async function health() {
  try {
    const response = await fetch(address("health/ready"), { cache: "no-store" });
    return (await response.json()).status ?? "lost";
  } catch {
    return "lost";
  }
}

export async function models() {
  return (await (await answered(asked("models"))).json()).models;
}

/**
 * @param {object} body a SimulateRequest
 * @param {AbortSignal} signal
 */
export async function simulate(body, signal) {
  const response = await answered(asked("simulate", { ...asJson(body), signal }));
  return response.json().catch(lostUnlessAborted);
}

/**
 * Ask for a forecast, all at once.
 * @param {FormData} body a PredictRequest with its images as file parts
 * @param {AbortSignal} signal
 */
export async function predict(body, signal) {
  const response = await answered(asked("predict", { method: "POST", body, signal }));
  return response.json().catch(lostUnlessAborted);
}

/**
 * Ask for a forecast, step by step.
 * @param {object | FormData} body a PredictRequest, as JSON or with its images as file parts
 * @param {AbortSignal} signal
 * @returns {AsyncGenerator<{step?: object, done?: object}>}
 */
export async function* predictStream(body, signal) {
  const sent = body instanceof FormData ? { method: "POST", body } : asJson(body);
  const response = await answered(asked("predict/stream", { ...sent, signal }));
  let finished = false;
  try {
    for await (const { event, data } of eventsOf(response.body)) {
      const document = JSON.parse(data);
      if (event === "error") throw new ServiceProblem(document);
      finished = event === "done";
      yield { [event]: document };
    }
  } catch (error) {
    lostUnlessAborted(error);
  }
  if (!finished) throw new LostService("The connection broke off in the middle of a forecast.");
}

function asJson(body) {
  const headers = { "Content-Type": "application/json" };
  return { method: "POST", headers, body: JSON.stringify(body) };
}

/** Send a request, with an API key once the service has asked for one. */
async function asked(path, init = {}) {
  for (;;) {
    const response = await fetch(address(path), withKey(init));
    if (response.status !== 401) return response;
    const problem = await response.clone().json().catch(() => null);
    if (!(await askForKey(problem?.detail ?? "The service asks for an API key."))) return response;
  }
}

/** @param {Promise<Response>} request */
async function answered(request) {
  const response = await request.catch(lostUnlessAborted);
  if (response.ok) return response;
  const problem = await response.json().catch(() => null);
  const retryAfter = Number(response.headers.get("Retry-After"));
  throw new ServiceProblem(
    problem?.title ? problem : unknown(response),
    retryAfter > 0 ? retryAfter : null,
  );
}

/** Proxies may answer too, without a problem document. */
function unknown(response) {
  const detail = `${response.url} answered ${response.status} without a reason.`;
  return { status: response.status, title: response.statusText || "No answer", detail };
}

/** @returns {never} */
function lostUnlessAborted(error) {
  if (error.name === "AbortError" || error instanceof ServiceProblem) throw error;
  throw new LostService("The service cannot be reached.", { cause: error });
}
