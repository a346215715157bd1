// Prints the UDP port that it listens to, then a line of JSON per datagram (osc.mjs). It ends when
// its input does.

import { asJson, listen } from "./osc.mjs";

console.log(await listen(0, (packet) => console.log(asJson(packet))));
process.stdin.resume().on("end", () => process.exit());
