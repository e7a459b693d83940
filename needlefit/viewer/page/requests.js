/** What is asked of the server by requests, and the token that they carry. */

/** The token that the address brought; kept, so that a page opened without it still knows it. */
export function token() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) sessionStorage.setItem("needlefit.token", given);
  return given ?? sessionStorage.getItem("needlefit.token") ?? "";
}

/** Ask for something; resolves with the answer, throws its reason as `{ what, where, expected, fix }`. */
export async function post(path, content) {
  const answer = await fetch(path, {
    method: "POST",
    headers: { Authorization: `Bearer ${token()}`, "Content-Type": "application/json" },
    body: JSON.stringify(content),
  }).catch(() => {
    throw { what: "the program does not answer", fix: "start needlefit view again" };
  });
  if (answer.ok) return answer;
  const text = await answer.text();
  try {
    return Promise.reject(JSON.parse(text));
  } catch {
    return Promise.reject({ what: text || answer.statusText }); // the answer is plain text
  }
}
