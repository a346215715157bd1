// A headless Chromium that draws WebGL in software. `npm ci` unpacks it, by running this file.

import { spawn } from "node:child_process";
import { mkdirSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import chromium from "@sparticuz/chromium";

const FOLDER = fileURLToPath(new URL("node_modules/.chromium", import.meta.url));

/** Opens a page; `profile` is a folder of its own. Returns the process. */
export function open(url, profile) {
  const options = chromium.args.filter((option) => option !== "--single-process");
  options.push(`--user-data-dir=${profile}`, "--enable-logging=stderr");
  options.push("--remote-debugging-port=0", url); // without the port it would not stay open
  return spawn(join(FOLDER, "chromium"), options, { stdio: ["ignore", "ignore", "inherit"] });
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  mkdirSync(FOLDER, { recursive: true });
  process.env.TMPDIR = FOLDER; // where the package unpacks to
  await chromium.executablePath();
}
