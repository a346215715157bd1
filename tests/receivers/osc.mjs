// OSC datagrams as JSON, read by osc.js.

import { createSocket } from "node:dgram";
import { once } from "node:events";
import osc from "osc";

/**
 * Listens to a UDP port of this machine (0: any) and calls back with each datagram as
 * {messages: [{address, types, values}], timeTag: [seconds, fraction] or null, same}: whether
 * osc.js writes the same bytes again. What is no OSC is told and skipped. Resolves to the port.
 */
export async function listen(port, received) {
  const socket = createSocket({ type: "udp4", recvBufferSize: 4 << 20 });
  socket.on("message", (datagram) => {
    let packet;
    try {
      packet = decoded(datagram);
    } catch (error) {
      console.error(`no OSC: ${error.message}`);
      return;
    }
    received(packet);
  });
  socket.bind(port, "127.0.0.1");
  await once(socket, "listening");
  return socket.address().port;
}

/** JSON has no NaN and no infinity: they are the strings "NaN", "Infinity" and "-Infinity". */
export function asJson(value) {
  const odd = (each) => typeof each === "number" && !Number.isFinite(each);
  return JSON.stringify(value, (_, each) => (odd(each) ? String(each) : each));
}

function decoded(datagram) {
  const packet = osc.readPacket(datagram, { metadata: true, unpackSingleArgs: false });
  const again = osc.writePacket(packet, { metadata: true });
  return {
    messages: [...flat(packet)],
    timeTag: packet.timeTag?.raw ?? null,
    same: Buffer.compare(datagram, again) === 0,
  };
}

function* flat(packet) {
  if (packet.packets) for (const part of packet.packets) yield* flat(part);
  else
    yield {
      address: packet.address,
      types: packet.args.map((each) => each.type).join(""),
      values: packet.args.map((each) => each.value),
    };
}
