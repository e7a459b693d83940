/** The thread that holds the socket: what comes in waits in the mailbox for the page's next frame. */

import { put } from "./mailbox.js";

let socket = null;

function begin({ address, hello, mailbox }) {
  const line = new WebSocket(address);
  socket = line;
  line.onopen = () => line.send(hello);
  line.onmessage = ({ data }) => {
    if (line !== socket) return;
    if (!mailbox) postMessage({ text: data });
    else if (put(mailbox, data)) postMessage({}); // for a page that draws no frames, as it is hidden
    else line.close(); // nobody reads
  };
  line.onclose = ({ code }) => line === socket && postMessage({ closed: code });
}

onmessage = ({ data }) => {
  if (data.address) begin(data);
  else if (data.text && socket.readyState === WebSocket.OPEN) socket.send(data.text);
  else if (data.close) {
    socket.close();
    socket = null; // none of its messages is passed on any more
  }
};
