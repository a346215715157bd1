// An avatar that the VMC protocol moves: UDP in, a page in a browser out.
//
//   node relay.mjs [UDP PORT]             then open the address that it prints in a browser
//   node relay.mjs 0 --headless FOLDER    opens the page itself, FOLDER is the browser's own
//
// With ?markers behind the address (a last argument "markers") they are shown beside the avatar.
//
// It prints {udp, url} as JSON and ends when its input does. GET /events is a stream of what came,
// GET /picture has the page draw itself (drawn() in page.mjs says what it answers).

import { createReadStream } from "node:fs";
import { createServer } from "node:http";
import { once } from "node:events";
import { extname, join, normalize } from "node:path";
import { fileURLToPath } from "node:url";
import { asJson, listen } from "./osc.mjs";

const HERE = fileURLToPath(new URL(".", import.meta.url));
const KINDS = { ".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript" };
const [udpPort = "39539", headless, folder, query] = process.argv.slice(2);

const pages = new Set(); // open streams of events
const waiting = new Set(); // who asked for a picture

const server = createServer((request, response) => {
  const path = normalize("/" + request.url.split("?")[0]); // no .. leads above the first /
  if (path === "/events") {
    response.writeHead(200, { "content-type": "text/event-stream" });
    response.flushHeaders();
    pages.add(response);
    response.on("close", () => pages.delete(response));
    if (waiting.size) tell("draw", {});
  } else if (path === "/picture" && request.method === "POST") {
    for (const asking of waiting) request.pipe(asking);
    waiting.clear();
    request.resume().on("end", () => response.end());
  } else if (path === "/picture") {
    waiting.add(response);
    response.on("close", () => waiting.delete(response));
    tell("draw", {});
  } else {
    const name = path === "/" ? "page.html" : path;
    const file = createReadStream(join(HERE, name));
    file.on("error", () => response.writeHead(404).end());
    file.on("open", () => {
      response.setHeader("content-type", KINDS[extname(name)] ?? "application/octet-stream");
      file.pipe(response);
    });
  }
});

function tell(event, data) {
  for (const page of pages) page.write(`event: ${event}\ndata: ${asJson(data)}\n\n`);
}

server.listen(0, "127.0.0.1");
await once(server, "listening");
const url = `http://127.0.0.1:${server.address().port}/`;
const udp = await listen(Number(udpPort), ({ messages }) => tell("vmc", messages));
console.log(JSON.stringify({ udp, url }));

let browser = null;
if (headless) browser = (await import("./browser.mjs")).open(`${url}?${query ?? ""}`, folder);

process.stdin.resume().on("end", async () => {
  browser?.kill("SIGKILL");
  if (browser) await once(browser, "exit");
  process.exit();
});
