// SPDX-License-Identifier: Apache-2.0
// The WebSocket: mirrors the broker's topics to `listener.onMessage`, comes back by itself. Each message holds one or
// several of ours, a line each.
// A token is sent as the first message, never in a URL; it stays in this tab's session.
const PAUSES_MS = [300, 1000, 2000, 5000];
const TOKEN = 'slamgw-token';

// null for what is none of our program's messages: one that cannot be read must not end the others.
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
    } catch (error) { // those that came with it are none the worse
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

  // Whether it could be said. `encoding`: "text" or "hex".
  say(topic, payload, encoding = 'text') {
    if (this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify({ topic, payload, encoding }));
    return true;
  }
}
