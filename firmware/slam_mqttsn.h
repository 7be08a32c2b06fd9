// SPDX-License-Identifier: Apache-2.0
// An MQTT-SN 1.2 client for a robot on Thread: octets and the time in, octets and the next deadline
// out. C99 without dependencies, no allocation, no socket, no clock; the memory is one struct of
// the caller. docs/robots.md shows how a robot uses this header, firmware/examples/thread_robot.c
// is an example.
//
// The client connects, registers and subscribes the topics of its table, and does so again whenever
// the gateway is lost. One message of QoS 1 or 2 is under way at a time. The client keeps and
// repeats this message until the gateway has acknowledged it, over a lost connection too.
//
//   slam_sn_init, slam_sn_connect                     once
//   slam_sn_receive                                   for each datagram from the gateway
//   slam_sn_publish                                   when there is something to say
//   slam_sn_poll until it returns nothing to send     after each of these, and when
//                                                     slam_sn_wait_ms has passed
//
// `now` is in milliseconds, by any clock that goes steadily and wraps at 2^32.
#ifndef SLAM_MQTTSN_H
#define SLAM_MQTTSN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

// Bounds, all of which may be set before the header is included.
#ifndef SLAM_SN_MAX_PACKET  // octets of the longest message that is sent
#define SLAM_SN_MAX_PACKET 264u
#endif
#ifndef SLAM_SN_MAX_TOPICS  // entries in the table of topics
#define SLAM_SN_MAX_TOPICS 8u
#endif
#ifndef SLAM_SN_MAX_HEARD  // topics that wildcard subscriptions bring; one more replaces the oldest
#define SLAM_SN_MAX_HEARD 4u
#endif
#ifndef SLAM_SN_MAX_NAME  // octets of the name of such a topic
#define SLAM_SN_MAX_NAME 64u
#endif

#if SLAM_SN_MAX_PACKET < 32 || SLAM_SN_MAX_PACKET > 65535 || SLAM_SN_MAX_NAME > 255
#error "SLAM_SN_MAX_PACKET is 32..65535, SLAM_SN_MAX_NAME at most 255"
#endif

#define SLAM_SN_HEADER_SIZE 9u  // of the longest header, a PUBLISH with a length of three octets
#define SLAM_SN_MAX_PAYLOAD (SLAM_SN_MAX_PACKET - SLAM_SN_HEADER_SIZE)
#define SLAM_SN_RETRY_MS 10000u        // T_retry (MQTT-SN 1.2 section 7.2)
#define SLAM_SN_RETRIES 3u             // N_retry
#define SLAM_SN_CONGESTION_MS 310000u  // T_WAIT, after return code 1
#define SLAM_SN_RECONNECT_MS 1000u  // before the CONNECT to a lost gateway, and up to as much again
#define SLAM_SN_NO_TOPIC 0xffu

// Flags of messages and topics.
#define SLAM_SN_QOS0 0x00u
#define SLAM_SN_QOS1 0x20u
#define SLAM_SN_QOS2 0x40u
#define SLAM_SN_RETAIN 0x10u
#define SLAM_SN_SUBSCRIBE 0x08u   // of a topic: the robot listens there, usually with SLAM_SN_QOS1
#define SLAM_SN_PREDEFINED 0x01u  // of a topic: has an id that the gateway's configuration gives it
#define SLAM_SN_SHORT 0x02u       // of a topic: its name has two octets and needs no id

enum slam_sn_code {
  SLAM_SN_ACCEPTED = 0,
  SLAM_SN_CONGESTION = 1,
  SLAM_SN_INVALID_TOPIC = 2,
  SLAM_SN_NOT_SUPPORTED = 3
};

struct slam_sn_topic {
  const char* name;  // whole, such as `ntnu-slam/robot/r1/update`; may have wildcards if subscribed
  uint16_t id;       // of a predefined topic
  uint8_t flags;     // 0: the robot publishes there
};

// All pointers must stay valid as long as the client is used.
struct slam_sn_settings {
  const char* client_id;               // the robot's id in topics
  const char* will_topic;              // NULL: no will
  const char* will_message;            // published by the gateway when the robot is lost
  const struct slam_sn_topic* topics;  // list published topics first: they are then ready first
  uint8_t topic_count;
  uint8_t will_flags;     // QoS, SLAM_SN_RETAIN
  bool clean_session;     // false: commands wait at the gateway while the robot is away
  uint8_t retries;        // 0: SLAM_SN_RETRIES
  uint16_t keep_alive_s;  // the robot is lost after 1.5 times this silence; at least 1
  uint16_t retry_ms;      // 0: SLAM_SN_RETRY_MS
};

enum slam_sn_event_kind {
  SLAM_SN_NOTHING,
  SLAM_SN_MESSAGE,    // a message came, described by the members below
  SLAM_SN_PUBLISHED,  // the message of QoS 1 or 2 has ended; `code` says how
  // `topic`, or the robot (SLAM_SN_NO_TOPIC), is refused; `code` says why. After SLAM_SN_CONGESTION
  // the client asks again, SLAM_SN_CONGESTION_MS later at the earliest.
  SLAM_SN_REFUSED
};

struct slam_sn_event {
  enum slam_sn_event_kind kind;
  uint8_t code;      // enum slam_sn_code
  uint8_t topic;     // its place in the table; SLAM_SN_NO_TOPIC: a wildcard subscription brought it
  uint8_t flags;     // QoS and SLAM_SN_RETAIN of a message
  const char* name;  // of the topic, without a zero at its end
  size_t name_size;
  const uint8_t* data;  // the payload, inside the datagram
  size_t size;
};

enum slam_sn_state { SLAM_SN_OFF, SLAM_SN_CONNECTING, SLAM_SN_ACTIVE, SLAM_SN_ASLEEP };

enum slam_sn_topic_state {
  SLAM_SN_UNSETTLED,
  SLAM_SN_SETTLED,
  SLAM_SN_TURNED_DOWN,
  SLAM_SN_POSTPONED  // turned down by congestion, and asked for again
};

struct slam_sn_heard_topic {
  uint16_t id;  // 0: free
  uint8_t size;
  char name[SLAM_SN_MAX_NAME];
};

struct slam_sn_client {
  const struct slam_sn_settings* settings;
  enum slam_sn_state state;
  uint16_t next_id;          // the message id of the next request, never 0
  uint16_t delivered_id;     // of the gateway's last message, to recognise its repeat
  bool is_delivered_before;  // on an earlier connection: then only DUP marks a repeat
  uint32_t answered_at;      // when the gateway last answered a request
  uint32_t heard_at;         // when the gateway last sent anything

  uint8_t asking;  // type of the open request about the connection; 0: none
  uint8_t asked_topic;
  uint8_t tries;
  uint8_t connacks;   // CONNACKs that may still come, one for each CONNECT that was sent
  bool resumes;       // the next CONNECT continues the session
  bool is_congested;  // the gateway has refused a topic with return code 1
  uint16_t asked_id;
  uint16_t sleep_s;
  uint32_t ask_at;     // when to send the request, or send it again
  uint32_t wake_at;    // when a sleeping client wakes
  uint32_t topics_at;  // when to ask for topics again, while is_congested

  uint16_t ids[SLAM_SN_MAX_TOPICS];
  uint8_t topic_states[SLAM_SN_MAX_TOPICS];
  uint8_t next_heard;
  struct slam_sn_heard_topic heard[SLAM_SN_MAX_HEARD];

  uint8_t publishing;  // type of the open message, PUBLISH or PUBREL; 0: none
  uint8_t publish_flags;
  uint8_t publish_topic;
  uint8_t publish_tries;
  uint16_t publish_id;
  uint16_t payload_size;
  uint32_t publish_at;

  uint16_t out_size;  // of the datagram in `out`; 0: none
  uint8_t out[SLAM_SN_MAX_PACKET];
  uint8_t payload[SLAM_SN_MAX_PAYLOAD];

  uint32_t invalid;  // datagrams that could not be read, or answered nothing
  uint32_t repeats;  // of messages from the gateway
  uint32_t lost;     // times that the gateway was lost
};

// Message types (MQTT-SN 1.2 section 5.2.2).
enum {
  SLAM_SN_CONNECT_ = 0x04,
  SLAM_SN_CONNACK_ = 0x05,
  SLAM_SN_WILLTOPICREQ_ = 0x06,
  SLAM_SN_WILLTOPIC_ = 0x07,
  SLAM_SN_WILLMSGREQ_ = 0x08,
  SLAM_SN_WILLMSG_ = 0x09,
  SLAM_SN_REGISTER_ = 0x0a,
  SLAM_SN_REGACK_ = 0x0b,
  SLAM_SN_PUBLISH_ = 0x0c,
  SLAM_SN_PUBACK_ = 0x0d,
  SLAM_SN_PUBCOMP_ = 0x0e,
  SLAM_SN_PUBREC_ = 0x0f,
  SLAM_SN_PUBREL_ = 0x10,
  SLAM_SN_SUBSCRIBE_ = 0x12,
  SLAM_SN_SUBACK_ = 0x13,
  SLAM_SN_PINGREQ_ = 0x16,
  SLAM_SN_PINGRESP_ = 0x17,
  SLAM_SN_DISCONNECT_ = 0x18
};

#define SLAM_SN_DUP_ 0x80u
#define SLAM_SN_QOS_ 0x60u
#define SLAM_SN_ID_TYPE_ 0x03u
#define SLAM_SN_WILL_ 0x08u
#define SLAM_SN_CLEAN_ 0x04u

// Octets

static inline size_t slam_sn_length_(const char* text) {
  size_t size = 0;
  while (text[size] != '\0') ++size;
  return size;
}

static inline bool slam_sn_equal_(const char* a, const char* b, size_t size) {
  size_t i = 0;
  for (i = 0; i < size; ++i)
    if (a[i] != b[i]) return false;
  return true;
}

static inline bool slam_sn_is_text_(const char* text, const char* name, size_t size) {
  return slam_sn_length_(text) == size && slam_sn_equal_(text, name, size);
}

static inline uint16_t slam_sn_read_(const uint8_t* octets) {
  return (uint16_t)((unsigned)octets[0] << 8 | octets[1]);
}

static inline uint8_t* slam_sn_write_(uint8_t* at, unsigned value) {
  *at++ = (uint8_t)(value >> 8 & 0xffu);
  *at++ = (uint8_t)(value & 0xffu);
  return at;
}

static inline uint8_t* slam_sn_copy_(uint8_t* at, const void* octets, size_t size) {
  const uint8_t* from = (const uint8_t*)octets;
  while (size-- > 0) *at++ = *from++;
  return at;
}

// Begins the next datagram. Returns where its `size` octets after the type go.
static inline uint8_t* slam_sn_begin_(struct slam_sn_client* client, unsigned type, size_t size) {
  uint8_t* at = client->out;
  size_t total = size + 2u;
  if (total > 255u) {
    total += 2u;
    *at++ = 1;
    at = slam_sn_write_(at, (unsigned)total);
  } else {
    *at++ = (uint8_t)total;
  }
  *at++ = (uint8_t)type;
  client->out_size = (uint16_t)total;
  return at;
}

// Time

static inline bool slam_sn_is_due_(uint32_t at, uint32_t now) {
  return now - at < UINT32_C(0x80000000);
}

static inline uint32_t slam_sn_until_(uint32_t at, uint32_t now) {
  return slam_sn_is_due_(at, now) ? 0 : at - now;
}

static inline uint32_t slam_sn_retry_ms_(const struct slam_sn_client* client) {
  return client->settings->retry_ms > 0 ? client->settings->retry_ms : SLAM_SN_RETRY_MS;
}

static inline unsigned slam_sn_retries_(const struct slam_sn_client* client) {
  return client->settings->retries > 0 ? client->settings->retries : SLAM_SN_RETRIES;
}

// Returns how long a request is repeated before the gateway counts as lost.
static inline uint32_t slam_sn_patience_ms_(const struct slam_sn_client* client) {
  return slam_sn_retry_ms_(client) * (slam_sn_retries_(client) + 1u);
}

// Topics

static inline const struct slam_sn_topic* slam_sn_topic_(const struct slam_sn_client* client,
                                                         size_t place) {
  return &client->settings->topics[place];
}

static inline bool slam_sn_has_name_(const struct slam_sn_topic* topic) {
  return (topic->flags & SLAM_SN_ID_TYPE_) == 0;
}

// A topic that the robot publishes needs a REGISTER unless its id is known to both sides.
static inline uint8_t slam_sn_first_state_(const struct slam_sn_topic* topic) {
  const bool needs_nothing = !slam_sn_has_name_(topic) && (topic->flags & SLAM_SN_SUBSCRIBE) == 0;
  return needs_nothing ? SLAM_SN_SETTLED : SLAM_SN_UNSETTLED;
}

static inline void slam_sn_unsettle_all_(struct slam_sn_client* client) {
  size_t i = 0;
  for (i = 0; i < client->settings->topic_count; ++i) {
    client->ids[i] = 0;
    client->topic_states[i] = slam_sn_first_state_(slam_sn_topic_(client, i));
  }
  for (i = 0; i < SLAM_SN_MAX_HEARD; ++i) client->heard[i].id = 0;
}

// Returns the first topic to ask the gateway about; topic_count: none.
static inline size_t slam_sn_unsettled_(const struct slam_sn_client* client) {
  size_t i = 0;
  while (i < client->settings->topic_count && client->topic_states[i] != SLAM_SN_UNSETTLED) ++i;
  return i;
}

// Notes the id that the gateway gave to a topic. If another name had this id before, that name
// loses it.
static inline bool slam_sn_learn_(struct slam_sn_client* client, uint16_t id, const char* name,
                                  size_t size) {
  struct slam_sn_heard_topic* place = NULL;
  bool is_in_table = false;
  size_t i = 0;
  for (i = 0; i < client->settings->topic_count; ++i) {
    const struct slam_sn_topic* topic = slam_sn_topic_(client, i);
    if (slam_sn_has_name_(topic) && slam_sn_is_text_(topic->name, name, size)) {
      client->ids[i] = id;
      is_in_table = true;
    } else if (client->ids[i] == id) {
      client->ids[i] = 0;
      client->topic_states[i] = slam_sn_first_state_(topic);
    }
  }
  for (i = 0; i < SLAM_SN_MAX_HEARD; ++i) {
    struct slam_sn_heard_topic* heard = &client->heard[i];
    if (heard->size == size && slam_sn_equal_(heard->name, name, size)) {
      place = heard;
    } else if (heard->id == id) {
      heard->id = 0;
    }
  }
  if (is_in_table) return true;
  if (size > SLAM_SN_MAX_NAME) return false;
  if (place == NULL) {
    place = &client->heard[client->next_heard];
    client->next_heard = (uint8_t)((client->next_heard + 1u) % SLAM_SN_MAX_HEARD);
  }
  place->id = id;
  place->size = (uint8_t)size;
  for (i = 0; i < size; ++i) place->name[i] = name[i];
  return true;
}

// Fills in the topic of a PUBLISH; `id` points to its two octets. Returns false for an unknown one.
static inline bool slam_sn_name_(const struct slam_sn_client* client, unsigned type,
                                 const uint8_t* id, struct slam_sn_event* event) {
  const uint16_t number = slam_sn_read_(id);
  size_t i = 0;
  event->topic = SLAM_SN_NO_TOPIC;
  event->name = (const char*)id;
  event->name_size = 2;
  for (i = 0; i < client->settings->topic_count; ++i) {
    const struct slam_sn_topic* topic = slam_sn_topic_(client, i);
    if ((topic->flags & SLAM_SN_ID_TYPE_) != type) continue;
    if (type == 0 && (number == 0 || client->ids[i] != number)) continue;
    if (type == SLAM_SN_PREDEFINED && topic->id != number) continue;
    if (type == SLAM_SN_SHORT && !slam_sn_equal_(topic->name, event->name, 2)) continue;
    event->topic = (uint8_t)i;
    event->name = topic->name;
    event->name_size = topic->name == NULL ? 0 : slam_sn_length_(topic->name);
    return true;
  }
  for (i = 0; type == 0 && i < SLAM_SN_MAX_HEARD; ++i) {
    if (number == 0 || client->heard[i].id != number) continue;
    event->name = client->heard[i].name;
    event->name_size = client->heard[i].size;
    return true;
  }
  return type == SLAM_SN_SHORT;
}

// Requests

static inline uint16_t slam_sn_take_id_(struct slam_sn_client* client) {
  const uint16_t id = client->next_id++;
  if (client->next_id == 0) client->next_id = 1;
  return id;
}

static inline void slam_sn_ask_(struct slam_sn_client* client, unsigned type, uint32_t at) {
  client->asking = (uint8_t)type;
  client->asked_id = slam_sn_take_id_(client);
  client->tries = 0;
  client->ask_at = at;
}

static inline void slam_sn_begin_connecting_(struct slam_sn_client* client, bool resumes,
                                             uint32_t at) {
  client->state = SLAM_SN_CONNECTING;
  client->resumes = resumes;
  if (client->settings->clean_session && !resumes) client->delivered_id = 0;
  client->is_delivered_before = true;
  client->is_congested = false;
  client->publish_tries = 0;
  slam_sn_unsettle_all_(client);
  slam_sn_ask_(client, SLAM_SN_CONNECT_, at);
}

// Call when the gateway is gone, or does not know the robot any more. The pause differs from robot
// to robot, so that they do not all come back at once.
static inline void slam_sn_lose_(struct slam_sn_client* client, uint32_t now) {
  const uint32_t spread = (client->next_id * UINT32_C(40503) >> 4) % SLAM_SN_RECONNECT_MS;
  ++client->lost;
  client->publish_at = now;
  slam_sn_begin_connecting_(client, false, now + SLAM_SN_RECONNECT_MS + spread);
}

static inline void slam_sn_write_connect_(struct slam_sn_client* client) {
  const struct slam_sn_settings* settings = client->settings;
  const size_t size = slam_sn_length_(settings->client_id);
  uint8_t* at = slam_sn_begin_(client, SLAM_SN_CONNECT_, 4u + size);
  *at = 0;
  if (settings->will_topic != NULL) *at |= SLAM_SN_WILL_;
  if (settings->clean_session && !client->resumes) *at |= SLAM_SN_CLEAN_;
  ++at;
  *at++ = 1;
  slam_sn_copy_(slam_sn_write_(at, settings->keep_alive_s), settings->client_id, size);
}

static inline void slam_sn_write_register_(struct slam_sn_client* client) {
  const char* name = slam_sn_topic_(client, client->asked_topic)->name;
  const size_t size = slam_sn_length_(name);
  uint8_t* at = slam_sn_begin_(client, SLAM_SN_REGISTER_, 4u + size);
  slam_sn_copy_(slam_sn_write_(slam_sn_write_(at, 0), client->asked_id), name, size);
}

static inline void slam_sn_write_subscribe_(struct slam_sn_client* client) {
  const struct slam_sn_topic* topic = slam_sn_topic_(client, client->asked_topic);
  const bool is_predefined = (topic->flags & SLAM_SN_PREDEFINED) != 0;
  const size_t size = is_predefined ? 2u : slam_sn_length_(topic->name);
  uint8_t* at = slam_sn_begin_(client, SLAM_SN_SUBSCRIBE_, 3u + size);
  *at = topic->flags & (SLAM_SN_QOS_ | SLAM_SN_ID_TYPE_);
  if (client->tries > 0) *at |= SLAM_SN_DUP_;
  at = slam_sn_write_(at + 1, client->asked_id);
  if (is_predefined) {
    slam_sn_write_(at, topic->id);
  } else {
    slam_sn_copy_(at, topic->name, size);
  }
}

// The duration of a sleep includes the time of the robot's repeats.
static inline void slam_sn_write_disconnect_(struct slam_sn_client* client) {
  uint32_t duration_s = client->sleep_s;
  if (duration_s == 0) {
    slam_sn_begin_(client, SLAM_SN_DISCONNECT_, 0);
    return;
  }
  duration_s += slam_sn_patience_ms_(client) / 1000u + 1u;
  if (duration_s > 0xffffu) duration_s = 0xffffu;
  slam_sn_write_(slam_sn_begin_(client, SLAM_SN_DISCONNECT_, 2), duration_s);
}

static inline void slam_sn_write_ping_(struct slam_sn_client* client) {
  const bool is_asleep = client->state == SLAM_SN_ASLEEP;
  const size_t size = is_asleep ? slam_sn_length_(client->settings->client_id) : 0;
  slam_sn_copy_(slam_sn_begin_(client, SLAM_SN_PINGREQ_, size), client->settings->client_id, size);
}

static inline void slam_sn_write_request_(struct slam_sn_client* client) {
  switch (client->asking) {
    case SLAM_SN_CONNECT_: slam_sn_write_connect_(client); break;
    case SLAM_SN_REGISTER_: slam_sn_write_register_(client); break;
    case SLAM_SN_SUBSCRIBE_: slam_sn_write_subscribe_(client); break;
    case SLAM_SN_PINGREQ_: slam_sn_write_ping_(client); break;
    default: slam_sn_write_disconnect_(client); break;
  }
}

static inline void slam_sn_write_publish_(struct slam_sn_client* client, size_t place,
                                          unsigned flags, uint16_t id, const uint8_t* data,
                                          size_t size) {
  const struct slam_sn_topic* topic = slam_sn_topic_(client, place);
  const unsigned type = topic->flags & SLAM_SN_ID_TYPE_;
  uint8_t* at = slam_sn_begin_(client, SLAM_SN_PUBLISH_, 5u + size);
  *at++ = (uint8_t)(flags | type);
  if (type == SLAM_SN_SHORT) {
    at = slam_sn_copy_(at, topic->name, 2);
  } else {
    at = slam_sn_write_(at, type == 0 ? client->ids[place] : topic->id);
  }
  slam_sn_copy_(slam_sn_write_(at, id), data, size);
}

// Writes the open PUBLISH or PUBREL.
static inline void slam_sn_write_open_(struct slam_sn_client* client) {
  if (client->publishing == SLAM_SN_PUBREL_) {
    slam_sn_write_(slam_sn_begin_(client, SLAM_SN_PUBREL_, 2), client->publish_id);
    return;
  }
  slam_sn_write_publish_(client, client->publish_topic, client->publish_flags, client->publish_id,
                         client->payload, client->payload_size);
  client->publish_flags |= SLAM_SN_DUP_;
}

static inline void slam_sn_write_answer_(struct slam_sn_client* client, unsigned type, uint16_t id,
                                         uint16_t message_id, uint8_t code) {
  uint8_t* at = slam_sn_begin_(client, type, 5);
  at = slam_sn_write_(slam_sn_write_(at, id), message_id);
  *at = code;
}

// Actions at their time

static inline bool slam_sn_may_send_open_(const struct slam_sn_client* client) {
  if (client->publishing == 0) return false;
  if (client->state != SLAM_SN_ACTIVE && client->state != SLAM_SN_ASLEEP) return false;
  return client->publishing == SLAM_SN_PUBREL_ ||
         client->topic_states[client->publish_topic] == SLAM_SN_SETTLED;
}

static inline uint32_t slam_sn_ping_at_(const struct slam_sn_client* client) {
  return client->answered_at + client->settings->keep_alive_s * UINT32_C(1000);
}

static inline void slam_sn_end_congestion_(struct slam_sn_client* client) {
  size_t i = 0;
  client->is_congested = false;
  for (i = 0; i < client->settings->topic_count; ++i)
    if (client->topic_states[i] == SLAM_SN_POSTPONED) client->topic_states[i] = SLAM_SN_UNSETTLED;
}

// Opens the request that is due next, if none is open.
static inline void slam_sn_choose_(struct slam_sn_client* client, uint32_t now) {
  size_t topic = 0;
  if (client->asking != 0) return;
  if (client->is_congested && slam_sn_is_due_(client->topics_at, now))
    slam_sn_end_congestion_(client);
  topic = slam_sn_unsettled_(client);
  if (client->state == SLAM_SN_ASLEEP) {
    if (slam_sn_is_due_(client->wake_at, now)) slam_sn_ask_(client, SLAM_SN_PINGREQ_, now);
  } else if (topic < client->settings->topic_count) {
    const bool listens = (slam_sn_topic_(client, topic)->flags & SLAM_SN_SUBSCRIBE) != 0;
    client->asked_topic = (uint8_t)topic;
    slam_sn_ask_(client, listens ? SLAM_SN_SUBSCRIBE_ : SLAM_SN_REGISTER_, now);
  } else if (slam_sn_is_due_(slam_sn_ping_at_(client), now)) {
    slam_sn_ask_(client, SLAM_SN_PINGREQ_, now);
  }
}

static inline void slam_sn_end_disconnecting_(struct slam_sn_client* client, uint32_t now) {
  client->asking = 0;
  client->state = client->sleep_s > 0 ? SLAM_SN_ASLEEP : SLAM_SN_OFF;
  client->wake_at = now + client->sleep_s * UINT32_C(1000);
}

// Returns true when the request has been repeated often enough, and nothing has come from the
// gateway since.
static inline bool slam_sn_is_silent_(const struct slam_sn_client* client, unsigned tries,
                                      uint32_t now) {
  return tries > slam_sn_retries_(client) && now - client->heard_at >= slam_sn_patience_ms_(client);
}

static inline void slam_sn_send_request_(struct slam_sn_client* client, uint32_t now) {
  const bool is_connecting = client->asking == SLAM_SN_CONNECT_;
  if (!is_connecting && slam_sn_is_silent_(client, client->tries, now)) {
    if (client->asking == SLAM_SN_DISCONNECT_) {
      slam_sn_end_disconnecting_(client, now);
    } else {
      slam_sn_lose_(client, now);
    }
    return;
  }
  slam_sn_write_request_(client);
  if (client->tries < 0xffu) ++client->tries;
  client->ask_at = now + slam_sn_retry_ms_(client);
}

static inline void slam_sn_send_open_(struct slam_sn_client* client, uint32_t now) {
  if (slam_sn_is_silent_(client, client->publish_tries, now)) {
    slam_sn_lose_(client, now);
    return;
  }
  slam_sn_write_open_(client);
  if (client->publish_tries < 0xffu) ++client->publish_tries;
  client->publish_at = now + slam_sn_retry_ms_(client);
}

// Messages from the gateway

static inline void slam_sn_answered_(struct slam_sn_client* client, uint32_t now) {
  client->asking = 0;
  client->answered_at = now;
}

static inline void slam_sn_end_publish_(struct slam_sn_client* client, uint8_t code,
                                        struct slam_sn_event* event) {
  client->publishing = 0;
  event->kind = SLAM_SN_PUBLISHED;
  event->code = code;
  event->topic = client->publish_topic;
}

static inline void slam_sn_refuse_(uint8_t topic, uint8_t code, struct slam_sn_event* event) {
  event->kind = SLAM_SN_REFUSED;
  event->code = code;
  event->topic = topic;
}

// Handles CONNACK. A second CONNACK answers a repeated CONNECT, which may have begun the session
// once more.
static inline bool slam_sn_on_connack_(struct slam_sn_client* client, uint8_t code, uint32_t now,
                                       struct slam_sn_event* event) {
  if (client->asking == SLAM_SN_CONNECT_ && code != SLAM_SN_ACCEPTED) {
    client->ask_at = now + SLAM_SN_CONGESTION_MS;
    slam_sn_refuse_(SLAM_SN_NO_TOPIC, code, event);
    return true;
  }
  if (code != SLAM_SN_ACCEPTED) return false;
  if (client->asking == SLAM_SN_CONNECT_) {
    client->state = SLAM_SN_ACTIVE;
    client->connacks = client->tries;
  } else if (client->state != SLAM_SN_ACTIVE || client->asking == SLAM_SN_DISCONNECT_ ||
             client->connacks == 0) {
    return false;
  }
  if (client->connacks > 0) --client->connacks;
  slam_sn_unsettle_all_(client);
  slam_sn_answered_(client, now);
  client->publish_at = now;
  return true;
}

static inline bool slam_sn_on_will_request_(struct slam_sn_client* client, unsigned type,
                                            uint32_t now) {
  const struct slam_sn_settings* settings = client->settings;
  const bool is_topic = type == SLAM_SN_WILLTOPICREQ_;
  const char* text = is_topic ? settings->will_topic : settings->will_message;
  uint8_t* at = NULL;
  if (client->asking != SLAM_SN_CONNECT_ || settings->will_topic == NULL) return false;
  const size_t size = text == NULL ? 0 : slam_sn_length_(text);
  at = slam_sn_begin_(client, type + 1u, size + (is_topic ? 1u : 0u));
  if (is_topic) *at++ = settings->will_flags & (SLAM_SN_QOS_ | SLAM_SN_RETAIN);
  slam_sn_copy_(at, text, size);
  client->ask_at = now + slam_sn_retry_ms_(client);
  return true;
}

// Handles REGACK and SUBACK. `id` is 0 for a wildcard.
static inline bool slam_sn_on_settled_(struct slam_sn_client* client, unsigned request, uint16_t id,
                                       const uint8_t* answer, uint32_t now,
                                       struct slam_sn_event* event) {
  const uint8_t topic = client->asked_topic;
  const uint8_t code = answer[2];
  if (client->asking != request || slam_sn_read_(answer) != client->asked_id) return false;
  slam_sn_answered_(client, now);
  if (code == SLAM_SN_ACCEPTED) {
    if (slam_sn_has_name_(slam_sn_topic_(client, topic))) client->ids[topic] = id;
    client->topic_states[topic] = SLAM_SN_SETTLED;
    return true;
  }
  client->topic_states[topic] = SLAM_SN_TURNED_DOWN;
  if (code == SLAM_SN_CONGESTION) {
    client->topic_states[topic] = SLAM_SN_POSTPONED;
    client->is_congested = true;
    client->topics_at = now + SLAM_SN_CONGESTION_MS;
  }
  if (client->publishing == SLAM_SN_PUBLISH_ && client->publish_topic == topic)
    client->publishing = 0;
  slam_sn_refuse_(topic, code, event);
  return true;
}

static inline bool slam_sn_on_register_(struct slam_sn_client* client, const uint8_t* body,
                                        size_t size) {
  const uint16_t id = slam_sn_read_(body);
  if (id == 0 || id == 0xffffu) return false;
  const bool is_known = slam_sn_learn_(client, id, (const char*)body + 4, size - 4u);
  slam_sn_write_answer_(client, SLAM_SN_REGACK_, id, slam_sn_read_(body + 2),
                        is_known ? SLAM_SN_ACCEPTED : SLAM_SN_NOT_SUPPORTED);
  return true;
}

static inline bool slam_sn_on_publish_(struct slam_sn_client* client, const uint8_t* body,
                                       size_t size, struct slam_sn_event* event) {
  const unsigned type = body[0] & SLAM_SN_ID_TYPE_;
  const unsigned qos = body[0] & SLAM_SN_QOS_;
  const uint16_t topic_id = slam_sn_read_(body + 1);
  const uint16_t id = slam_sn_read_(body + 3);
  if (qos == SLAM_SN_QOS_ || type == SLAM_SN_ID_TYPE_) return false;
  if (!slam_sn_name_(client, type, body + 1, event)) {
    slam_sn_write_answer_(client, SLAM_SN_PUBACK_, topic_id, id, SLAM_SN_INVALID_TOPIC);
    return true;
  }
  if (qos == SLAM_SN_QOS1) {
    slam_sn_write_answer_(client, SLAM_SN_PUBACK_, topic_id, id, SLAM_SN_ACCEPTED);
  } else if (qos == SLAM_SN_QOS2) {
    slam_sn_write_(slam_sn_begin_(client, SLAM_SN_PUBREC_, 2), id);
  }
  if (qos != SLAM_SN_QOS0) {
    const bool is_second = (body[0] & SLAM_SN_DUP_) != 0;
    const bool may_repeat = is_second || (qos == SLAM_SN_QOS2 && !client->is_delivered_before);
    if (may_repeat && id != 0 && id == client->delivered_id) {
      ++client->repeats;
      return true;
    }
    client->delivered_id = id;
    client->is_delivered_before = false;
  }
  event->kind = SLAM_SN_MESSAGE;
  event->flags = body[0] & (SLAM_SN_QOS_ | SLAM_SN_RETAIN);
  event->data = body + 5;
  event->size = size - 5u;
  return true;
}

// Handles PUBACK. Code 2 also answers messages of QoS 0. A topic of the table is then registered
// again.
static inline bool slam_sn_on_puback_(struct slam_sn_client* client, const uint8_t* body,
                                      uint32_t now, struct slam_sn_event* event) {
  const uint16_t topic_id = slam_sn_read_(body);
  const uint8_t code = body[4];
  const bool is_open =
      client->publishing == SLAM_SN_PUBLISH_ && slam_sn_read_(body + 2) == client->publish_id;
  bool is_known = is_open;
  bool is_forgotten = false;
  size_t i = 0;
  for (i = 0; code == SLAM_SN_INVALID_TOPIC && i < client->settings->topic_count; ++i) {
    const bool is_of_open = is_open && i == client->publish_topic;
    if (!slam_sn_has_name_(slam_sn_topic_(client, i))) continue;
    if (!is_of_open && (topic_id == 0 || client->ids[i] != topic_id)) continue;
    client->topic_states[i] = SLAM_SN_UNSETTLED;
    is_known = true;
    if (is_of_open) is_forgotten = true;
  }
  if (is_known) client->answered_at = now;
  if (!is_open) return is_known;
  if (is_forgotten) {
    client->publish_at = now + slam_sn_retry_ms_(client);
  } else if (code == SLAM_SN_CONGESTION) {
    client->publish_at = now + SLAM_SN_CONGESTION_MS;
  } else {
    slam_sn_end_publish_(client, code, event);
  }
  return true;
}

// Handles PUBREC and PUBCOMP.
static inline bool slam_sn_on_qos2_(struct slam_sn_client* client, unsigned type, uint16_t id,
                                    uint32_t now, struct slam_sn_event* event) {
  const bool is_open = client->publishing != 0 && client->publish_id == id &&
                       (client->publish_flags & SLAM_SN_QOS_) == SLAM_SN_QOS2;
  if (!is_open || (type == SLAM_SN_PUBCOMP_ && client->publishing != SLAM_SN_PUBREL_)) return false;
  client->answered_at = now;
  if (type == SLAM_SN_PUBCOMP_) {
    slam_sn_end_publish_(client, SLAM_SN_ACCEPTED, event);
    return true;
  }
  client->publishing = SLAM_SN_PUBREL_;
  client->publish_tries = 0;
  client->publish_at = now;
  return true;
}

static inline bool slam_sn_on_pingresp_(struct slam_sn_client* client, uint32_t now) {
  if (client->asking != SLAM_SN_PINGREQ_) return false;
  slam_sn_answered_(client, now);
  client->wake_at = now + client->sleep_s * UINT32_C(1000);
  return true;
}

static inline bool slam_sn_on_disconnect_(struct slam_sn_client* client, uint32_t now) {
  if (client->asking == SLAM_SN_DISCONNECT_) {
    client->answered_at = now;
    slam_sn_end_disconnecting_(client, now);
  } else if (client->state != SLAM_SN_CONNECTING) {
    slam_sn_lose_(client, now);
  }
  return true;
}

// Returns true if a message of this type from a gateway may have `size` octets after the type.
static inline bool slam_sn_has_valid_size_(unsigned type, size_t size) {
  switch (type) {
    case SLAM_SN_CONNACK_: return size == 1;
    case SLAM_SN_WILLTOPICREQ_:
    case SLAM_SN_WILLMSGREQ_:
    case SLAM_SN_PINGRESP_:
    case SLAM_SN_DISCONNECT_: return size == 0;
    case SLAM_SN_PINGREQ_: return true;
    case SLAM_SN_PUBLISH_:
    case SLAM_SN_REGISTER_: return size >= 5;
    case SLAM_SN_REGACK_:
    case SLAM_SN_PUBACK_: return size == 5;
    case SLAM_SN_SUBACK_: return size == 6;
    case SLAM_SN_PUBCOMP_:
    case SLAM_SN_PUBREC_:
    case SLAM_SN_PUBREL_: return size == 2;
    default: return false;
  }
}

// Until CONNACK, only answers to CONNECT are expected.
static inline bool slam_sn_is_expected_(const struct slam_sn_client* client, unsigned type) {
  if (client->state == SLAM_SN_OFF) return false;
  if (client->state != SLAM_SN_CONNECTING) return true;
  return type == SLAM_SN_CONNACK_ || type == SLAM_SN_WILLTOPICREQ_ || type == SLAM_SN_WILLMSGREQ_ ||
         type == SLAM_SN_DISCONNECT_;
}

static inline bool slam_sn_on_message_(struct slam_sn_client* client, unsigned type,
                                       const uint8_t* body, size_t size, uint32_t now,
                                       struct slam_sn_event* event) {
  if (client->state == SLAM_SN_ASLEEP && client->asking == SLAM_SN_PINGREQ_) {
    client->tries = 1;  // PINGRESP comes after the messages that waited
    client->ask_at = now + slam_sn_retry_ms_(client);
  }
  switch (type) {
    case SLAM_SN_CONNACK_: return slam_sn_on_connack_(client, body[0], now, event);
    case SLAM_SN_WILLTOPICREQ_:
    case SLAM_SN_WILLMSGREQ_: return slam_sn_on_will_request_(client, type, now);
    case SLAM_SN_REGISTER_: return slam_sn_on_register_(client, body, size);
    case SLAM_SN_REGACK_: {
      const uint16_t id = slam_sn_read_(body);
      if (body[4] == SLAM_SN_ACCEPTED && (id == 0 || id == 0xffffu)) return false;
      return slam_sn_on_settled_(client, SLAM_SN_REGISTER_, id, body + 2, now, event);
    }
    case SLAM_SN_SUBACK_:
      return slam_sn_on_settled_(client, SLAM_SN_SUBSCRIBE_, slam_sn_read_(body + 1), body + 3, now,
                                 event);
    case SLAM_SN_PUBLISH_: return slam_sn_on_publish_(client, body, size, event);
    case SLAM_SN_PUBACK_: return slam_sn_on_puback_(client, body, now, event);
    case SLAM_SN_PUBREC_:
    case SLAM_SN_PUBCOMP_: return slam_sn_on_qos2_(client, type, slam_sn_read_(body), now, event);
    case SLAM_SN_PUBREL_:  // delivered_id stays: the network may still bring a late copy
      slam_sn_copy_(slam_sn_begin_(client, SLAM_SN_PUBCOMP_, 2), body, 2);
      return true;
    case SLAM_SN_PINGREQ_: slam_sn_begin_(client, SLAM_SN_PINGRESP_, 0); return true;
    case SLAM_SN_PINGRESP_: return slam_sn_on_pingresp_(client, now);
    default: return slam_sn_on_disconnect_(client, now);
  }
}

// Functions for the robot

// `random` must differ from robot to robot and from start to start: message ids begin with it.
// Returns false when the settings are invalid, or too long for SLAM_SN_MAX_PACKET.
static inline bool slam_sn_init(struct slam_sn_client* client,
                                const struct slam_sn_settings* settings, uint16_t random) {
  const size_t most = SLAM_SN_MAX_PAYLOAD;
  const size_t id_size = slam_sn_length_(settings->client_id);
  uint8_t* octets = (uint8_t*)client;
  size_t i = 0;
  for (i = 0; i < sizeof *client; ++i) octets[i] = 0;
  client->settings = settings;
  client->next_id = random == 0 ? 1 : random;
  if (id_size == 0 || id_size > most || settings->keep_alive_s == 0) return false;
  if (settings->topic_count > SLAM_SN_MAX_TOPICS) return false;
  if (settings->will_topic != NULL &&
      (settings->will_topic[0] == '\0' || slam_sn_length_(settings->will_topic) > most))
    return false;
  if (settings->will_message != NULL && slam_sn_length_(settings->will_message) > most)
    return false;
  for (i = 0; i < settings->topic_count; ++i) {
    const struct slam_sn_topic* topic = &settings->topics[i];
    if ((topic->flags & SLAM_SN_ID_TYPE_) == SLAM_SN_ID_TYPE_) return false;
    if ((topic->flags & SLAM_SN_PREDEFINED) != 0) continue;
    if (topic->name == NULL || topic->name[0] == '\0' || slam_sn_length_(topic->name) > most)
      return false;
    if ((topic->flags & SLAM_SN_SHORT) != 0 && slam_sn_length_(topic->name) != 2) return false;
  }
  return true;
}

// Connects, also again after slam_sn_disconnect().
static inline void slam_sn_connect(struct slam_sn_client* client, uint32_t now) {
  slam_sn_begin_connecting_(client, false, now);
  client->publish_at = now;
}

// Returns true when connected, with each topic of the table registered, subscribed or refused.
static inline bool slam_sn_is_ready(const struct slam_sn_client* client) {
  return client->state == SLAM_SN_ACTIVE &&
         slam_sn_unsettled_(client) == client->settings->topic_count;
}

// Returns true while a message of QoS 1 or 2 is under way.
static inline bool slam_sn_is_publishing(const struct slam_sn_client* client) {
  return client->publishing != 0;
}

// Returns true when nothing is under way and the client sleeps: the radio may be off for
// slam_sn_wait_ms().
static inline bool slam_sn_is_dozing(const struct slam_sn_client* client) {
  return client->state == SLAM_SN_ASLEEP && client->asking == 0 && client->publishing == 0 &&
         client->out_size == 0;
}

// `flags`: QoS and SLAM_SN_RETAIN. Returns false when the message can't be taken now (try again
// later) or never (the topic is refused, `data` is too long). QoS 0 needs a registered topic, and
// may be lost. One message of QoS 1 or 2 is taken at any time, also while the gateway is lost.
// SLAM_SN_PUBLISHED ends it, or SLAM_SN_REFUSED of its topic.
static inline bool slam_sn_publish(struct slam_sn_client* client, uint32_t now, uint8_t topic,
                                   uint8_t flags, const void* data, size_t size) {
  const unsigned qos = flags & SLAM_SN_QOS_;
  if (client->state == SLAM_SN_OFF || topic >= client->settings->topic_count) return false;
  if (size > SLAM_SN_MAX_PAYLOAD || qos == SLAM_SN_QOS_) return false;
  if (client->topic_states[topic] >= SLAM_SN_TURNED_DOWN) return false;
  if ((slam_sn_topic_(client, topic)->flags & SLAM_SN_SUBSCRIBE) != 0) return false;
  flags &= SLAM_SN_QOS_ | SLAM_SN_RETAIN;
  if (qos == SLAM_SN_QOS0) {
    const bool is_known = client->topic_states[topic] == SLAM_SN_SETTLED &&
                          (client->state == SLAM_SN_ACTIVE || client->state == SLAM_SN_ASLEEP);
    if (!is_known || client->out_size != 0) return false;
    slam_sn_write_publish_(client, topic, flags, 0, (const uint8_t*)data, size);
    return true;
  }
  if (client->publishing != 0) return false;
  client->publishing = SLAM_SN_PUBLISH_;
  client->publish_flags = flags;
  client->publish_topic = topic;
  client->publish_tries = 0;
  client->publish_id = slam_sn_take_id_(client);
  client->publish_at = now;
  client->payload_size = (uint16_t)size;
  slam_sn_copy_(client->payload, data, size);
  return true;
}

// Sleeps, and asks the gateway every `seconds` for waiting messages. Returns false when something
// is under way, or the client is neither ready nor asleep.
static inline bool slam_sn_sleep(struct slam_sn_client* client, uint32_t now, uint16_t seconds) {
  if (seconds == 0 || client->asking != 0 || client->publishing != 0) return false;
  if (client->state != SLAM_SN_ASLEEP && !slam_sn_is_ready(client)) return false;
  client->sleep_s = seconds;
  slam_sn_ask_(client, SLAM_SN_DISCONNECT_, now);
  return true;
}

// Ends the sleep. The session continues, and the messages that wait at the gateway come.
static inline void slam_sn_wake(struct slam_sn_client* client, uint32_t now) {
  if (client->state == SLAM_SN_ASLEEP) slam_sn_begin_connecting_(client, true, now);
}

// Disconnects without a will. Drops the message that is under way.
static inline void slam_sn_disconnect(struct slam_sn_client* client, uint32_t now) {
  if (client->state == SLAM_SN_OFF) return;
  client->sleep_s = 0;
  client->publishing = 0;
  slam_sn_ask_(client, SLAM_SN_DISCONNECT_, now);
}

// Takes one datagram from the gateway's address, and fills in `event` for the robot.
static inline void slam_sn_receive(struct slam_sn_client* client, uint32_t now,
                                   const uint8_t* datagram, size_t size,
                                   struct slam_sn_event* event) {
  size_t at = 1;
  event->kind = SLAM_SN_NOTHING;
  event->code = SLAM_SN_ACCEPTED;
  event->topic = SLAM_SN_NO_TOPIC;
  event->flags = 0;
  event->name = NULL;
  event->name_size = 0;
  event->data = NULL;
  event->size = 0;
  if (size >= 4 && datagram[0] == 1) at = 3;
  if (size > at && (at == 3 ? slam_sn_read_(datagram + 1) : datagram[0]) == size) {
    const unsigned type = datagram[at++];
    if (slam_sn_has_valid_size_(type, size - at) && slam_sn_is_expected_(client, type) &&
        slam_sn_on_message_(client, type, datagram + at, size - at, now, event)) {
      client->heard_at = now;
      return;
    }
  }
  ++client->invalid;
}

// Returns the next datagram to send, `*size` octets that are valid until the next call; 0: nothing
// now.
static inline const uint8_t* slam_sn_poll(struct slam_sn_client* client, uint32_t now,
                                          size_t* size) {
  if (client->out_size == 0 && client->state != SLAM_SN_OFF) {
    if (client->state != SLAM_SN_CONNECTING) slam_sn_choose_(client, now);
    if (client->asking != 0 && slam_sn_is_due_(client->ask_at, now))
      slam_sn_send_request_(client, now);
    if (client->out_size == 0 && slam_sn_may_send_open_(client) &&
        slam_sn_is_due_(client->publish_at, now))
      slam_sn_send_open_(client, now);
  }
  *size = client->out_size;
  client->out_size = 0;
  return client->out;
}

// Returns the milliseconds until slam_sn_poll() has something to do; UINT32_MAX: never by itself.
static inline uint32_t slam_sn_wait_ms(const struct slam_sn_client* client, uint32_t now) {
  uint32_t wait = UINT32_MAX;
  if (client->out_size != 0) return 0;
  if (client->state == SLAM_SN_OFF) return wait;
  if (client->asking != 0) {
    wait = slam_sn_until_(client->ask_at, now);
  } else if (client->state == SLAM_SN_ASLEEP) {
    wait = slam_sn_until_(client->wake_at, now);
  } else if (slam_sn_unsettled_(client) < client->settings->topic_count) {
    wait = 0;
  } else {
    wait = slam_sn_until_(slam_sn_ping_at_(client), now);
  }
  if (slam_sn_may_send_open_(client)) {
    const uint32_t until = slam_sn_until_(client->publish_at, now);
    if (until < wait) wait = until;
  }
  return wait;
}

// Returns true if the last level of the message's topic is `type`: `cmd` of
// `ntnu-slam/server/r1/cmd`.
static inline bool slam_sn_is_of_type(const struct slam_sn_event* event, const char* type) {
  const size_t size = slam_sn_length_(type);
  if (event->name == NULL || event->name_size < size + 1u) return false;
  const char* level = event->name + event->name_size - size;
  return level[-1] == '/' && slam_sn_equal_(level, type, size);
}

#ifdef __cplusplus
}
#endif

#endif
