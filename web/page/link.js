// SPDX-License-Identifier: Apache-2.0
// The WebSocket: passes messages on the broker's topics to `listener.onMessage`, and reconnects by itself. Each WebSocket
// message holds one or several of ours, a line each.
// A token is sent as the first message, never in a URL; it stays in this tab's session.
const PAUSES_MS = [300, 1000, 2000, 5000];
const TOKEN = 'slamgw-token';

// Returns null for text that is not a message of our program: one bad line must not stop the others.
function read(text) {
  try {
    const message = JSON.parse(text);
    return typeof message.topic === 'string' ? message : null;
  } catch {
    return null;
  }
}

export class Link {
  constructor(listener) {
    this.listener = listener;
    this.tries = 0;
    this.connect();
  }

  connect() {
    const scheme = location.protocol === 'https:' ? 'wss://' : 'ws://';
    const socket = new WebSocket(scheme + location.host + '/api');
    this.socket = socket;
    socket.onopen = () => {
      this.tries = 0;
      if (sessionStorage.getItem(TOKEN)) this.say('$web/token', sessionStorage.getItem(TOKEN));
      this.listener.onOpen();
    };
    socket.onmessage = (event) => event.data.split('\n').forEach((line) => this.take(read(line)));
    socket.onclose = () => {
      this.listener.onClose();
      setTimeout(() => this.connect(), PAUSES_MS[Math.min(this.tries++, PAUSES_MS.length - 1)]);
    };
  }

  take(message) {
    if (!message) return;
    if (message.topic === '$web/token' && !message.payload.accepted) sessionStorage.removeItem(TOKEN);
    try {
      this.listener.onMessage(message);
    } catch (error) { // must not stop the messages that came with this one
      console.error(error);
    }
  }
  hasToken() {
    return sessionStorage.getItem(TOKEN) !== null;
  }
  unlock(token) {
    sessionStorage.setItem(TOKEN, token);
    return this.say('$web/token', token);
  }
  lock() {
    sessionStorage.removeItem(TOKEN);
    this.socket.close();
  }

  // Sends a message; returns false without a connection. `encoding`: "text" or "hex".
  say(topic, payload, encoding = 'text') {
    if (this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify({ topic, payload, encoding }));
    return true;
  }
}
