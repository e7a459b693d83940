/** What is asked of the server. */

const given = new URLSearchParams(location.hash.slice(1)).get("token");
if (given) sessionStorage.setItem("needlefit.token", given);
const token = given ?? sessionStorage.getItem("needlefit.token") ?? "";

/** Ask for something; resolves with the answer, throws its reason as `{ what, where, expected, fix }`. */
export async function ask(name, content = {}) {
  const answer = await fetch(`/scan/${name}`, {
    method: "POST",
    headers: { Authorization: `Bearer ${token}`, "Content-Type": "application/json" },
    body: JSON.stringify(content),
  }).catch(() => {
    throw { what: "the program does not answer", fix: "start needlefit view again" };
  });
  if (answer.ok) return name === "cut" ? answer.blob() : answer.json();
  const text = await answer.text();
  let reason = { what: text || answer.statusText };
  try {
    reason = JSON.parse(text);
  } catch {
    // the answer is plain text
  }
  throw reason;
}
