// SPDX-License-Identifier: Apache-2.0
// A robot on Thread: it drives in a circle, says where it is, and obeys `cmd` and `run`. Here it
// runs on a computer, so that it can be tried without a board:
//
//   cc -std=c99 -Ifirmware -o thread_robot firmware/examples/thread_robot.c
//   ./thread_robot 127.0.0.1 47193 my-robot
//
// In firmware, open_socket(), send_datagram(), receive_datagram() and now_ms() become calls of the
// network stack; the rest stays.
#define _POSIX_C_SOURCE 200809L
#include <netdb.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "slam_ble_models.h"  // positions are the same octets on both meshes
#include "slam_mqttsn.h"

#define UPDATE_PERIOD_MS 200u

static int udp = -1;

// A connected socket hears the gateway only, as a robot should.
static bool open_socket(const char* host, const char* port) {
  struct addrinfo hints;
  struct addrinfo* found = NULL;
  memset(&hints, 0, sizeof hints);
  hints.ai_socktype = SOCK_DGRAM;
  if (getaddrinfo(host, port, &hints, &found) != 0) return false;
  udp = socket(found->ai_family, SOCK_DGRAM, 0);
  const bool is_open = udp >= 0 && connect(udp, found->ai_addr, found->ai_addrlen) == 0;
  freeaddrinfo(found);
  return is_open;
}

// One that does not leave is repeated like one that is lost on the way.
static void send_datagram(const uint8_t* octets, size_t size) {
  if (send(udp, octets, size, 0) < 0) return;
}

// Waits up to `wait_ms` for a datagram; 0: none came.
static size_t receive_datagram(uint8_t* octets, size_t capacity, uint32_t wait_ms) {
  struct pollfd readable = {udp, POLLIN, 0};
  if (poll(&readable, 1, (int)wait_ms) <= 0) return 0;
  const ssize_t size = recv(udp, octets, capacity, 0);
  return size > 0 ? (size_t)size : 0;
}

static uint32_t now_ms(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (uint32_t)(now.tv_sec * 1000 + now.tv_nsec / 1000000);
}

// The robot's body

static const struct slam_position circle[] = {{40, 0},  {28, 28},   {0, 40},  {-28, 28},
                                              {-40, 0}, {-28, -28}, {0, -40}, {28, -28}};
static size_t place = 0;
static bool is_running = true;

// `run` is one octet 0 or 1, or a word: docs/topics.md.
static bool is_start(const struct slam_sn_event* event) {
  static const char* const words[] = {"1", "on", "start", "unpause"};
  size_t i = 0;
  for (i = 0; i < sizeof words / sizeof *words; ++i)
    if (event->size == strlen(words[i]) && memcmp(event->data, words[i], event->size) == 0)
      return true;
  return event->size == 1 && event->data[0] == 1;
}

static void obey(const struct slam_sn_event* event) {
  struct slam_position target;
  if (slam_sn_is_of_type(event, "cmd") &&
      slam_decode_positions(event->data, event->size, &target, 1) == 1) {
    printf("cmd %d %d\n", target.x_cm, target.y_cm);  // drive there
  }
  if (slam_sn_is_of_type(event, "run")) {
    is_running = is_start(event);
    printf("run %d\n", is_running);
  }
}

static size_t measure(uint8_t* update, size_t capacity) {
  if (is_running) place = (place + 1) % (sizeof circle / sizeof *circle);
  const struct slam_position seen[2] = {circle[place], {70, 70}};  // the robot, and an obstacle
  return slam_encode_positions(seen, 2, update, capacity);
}

// What it says

static char update_topic[96];
static char commands_filter[96];
static char will_topic[96];
static const struct slam_sn_topic topics[] = {
    {update_topic, 0, 0},
    {commands_filter, 0, SLAM_SN_SUBSCRIBE | SLAM_SN_QOS1},
};
enum { UPDATE, COMMANDS };

static struct slam_sn_settings settings;
static struct slam_sn_client client;

static bool begin(const char* id) {
  snprintf(update_topic, sizeof update_topic, "ntnu-slam/robot/%s/update", id);
  snprintf(commands_filter, sizeof commands_filter, "ntnu-slam/server/%s/+", id);
  snprintf(will_topic, sizeof will_topic, "ntnu-slam/robot/%s/will", id);
  settings.client_id = id;
  settings.will_topic = will_topic;
  settings.will_message = "lost";
  settings.will_flags = SLAM_SN_QOS1;
  settings.clean_session = true;
  settings.keep_alive_s = 6;
  settings.retry_ms = 1000;
  settings.topics = topics;
  settings.topic_count = sizeof topics / sizeof *topics;
  if (!slam_sn_init(&client, &settings, (uint16_t)(now_ms() ^ (uint32_t)getpid()))) return false;
  slam_sn_connect(&client, now_ms());
  return true;
}

static void send_all(void) {
  size_t size = 0;
  const uint8_t* octets = slam_sn_poll(&client, now_ms(), &size);
  while (size > 0) {
    send_datagram(octets, size);
    octets = slam_sn_poll(&client, now_ms(), &size);
  }
}

// Measures when it is time, unless the last update is still under way.
static void say(uint32_t* next_update) {
  uint8_t update[SLAM_MAX_POSITIONS * SLAM_POSITION_SIZE];
  if (now_ms() - *next_update >= UINT32_C(0x80000000)) return;
  *next_update = now_ms() + UPDATE_PERIOD_MS;
  if (slam_sn_is_publishing(&client)) return;
  const size_t size = measure(update, sizeof update);
  slam_sn_publish(&client, now_ms(), UPDATE, SLAM_SN_QOS1, update, size);
}

static void hear(uint32_t wait_ms) {
  static uint8_t datagram[512];
  struct slam_sn_event event;
  const size_t size = receive_datagram(datagram, sizeof datagram, wait_ms);
  if (size == 0) return;
  slam_sn_receive(&client, now_ms(), datagram, size, &event);
  if (event.kind == SLAM_SN_MESSAGE) obey(&event);
  if (event.kind == SLAM_SN_REFUSED || (event.kind == SLAM_SN_PUBLISHED && event.code != 0))
    printf("refused %u: topic %u\n", (unsigned)event.code, (unsigned)event.topic);
}

int main(int count, char** arguments) {
  bool was_ready = false;
  if (count != 4 || !open_socket(arguments[1], arguments[2]) || !begin(arguments[3])) {
    fprintf(stderr, "usage: thread_robot HOST PORT ID\n");
    return 2;
  }
  setvbuf(stdout, NULL, _IOLBF, 0);
  uint32_t next_update = now_ms();
  for (;;) {
    say(&next_update);
    send_all();
    if (slam_sn_is_ready(&client) != was_ready) {
      was_ready = !was_ready;
      printf(was_ready ? "ready\n" : "the gateway is lost\n");
    }
    const uint32_t wait = slam_sn_wait_ms(&client, now_ms());
    hear(wait < UPDATE_PERIOD_MS ? wait : UPDATE_PERIOD_MS);
  }
}
