// SPDX-License-Identifier: Apache-2.0
// MQTT-SN 1.2 messages byte for byte, with their fields as tests/mqttsn_udp/describe.hpp says them.
// Lengths and fields were checked against two other decoders (Wireshark's and Eclipse Paho's).
#pragma once

#include <array>
#include <string_view>

namespace slamgw::mqttsn {

struct MessageVector {
  std::string_view name;
  std::string_view wire;
  std::string_view fields;
  bool is_canonical = true;  ///< false: we read it, and write it otherwise
};

inline constexpr std::array<MessageVector, 76> message_vectors{{
    {"ADVERTISE-900s-gw1", "05 00 01 03 84", "ADVERTISE gw=1 duration=900"},
    {"SEARCHGW-radius1", "03 01 01", "SEARCHGW radius=1"},
    {"SEARCHGW-radius0", "03 01 00", "SEARCHGW radius=0"},
    {"GWINFO-from-gw", "03 02 01", "GWINFO gw=1 address="},
    {"GWINFO-from-client-v4addr", "08 02 01 04 0a 00 00 01", "GWINFO gw=1 address=040a000001"},
    {"CONNECT-clean-60s-r1", "08 04 04 01 00 3c 72 31",
     "CONNECT will=0 clean=1 protocol=1 duration=60 client=r1"},
    {"CONNECT-noclean-60s-r1", "08 04 00 01 00 3c 72 31",
     "CONNECT will=0 clean=0 protocol=1 duration=60 client=r1"},
    {"CONNECT-will-clean-60s-r1", "08 04 0c 01 00 3c 72 31",
     "CONNECT will=1 clean=1 protocol=1 duration=60 client=r1"},
    {"CONNECT-will-noclean-60s-r1", "08 04 08 01 00 3c 72 31",
     "CONNECT will=1 clean=0 protocol=1 duration=60 client=r1"},
    {"CONNECT-23charid",
     "1d 04 04 01 0e 10 41 42 43 44 45 46 47 48 49 4a 4b 4c 4d 4e 4f 50 51 52 53 54 55 56 57",
     "CONNECT will=0 clean=1 protocol=1 duration=3600 client=ABCDEFGHIJKLMNOPQRSTUVW"},
    {"CONNECT-3octet-length", "01 00 0a 04 04 01 00 3c 72 31",
     "CONNECT will=0 clean=1 protocol=1 duration=60 client=r1", false},
    {"CONNACK-accepted", "03 05 00", "CONNACK code=0"},
    {"CONNACK-congestion", "03 05 01", "CONNACK code=1"},
    {"CONNACK-invalidtopic", "03 05 02", "CONNACK code=2"},
    {"CONNACK-notsupported", "03 05 03", "CONNACK code=3"},
    {"WILLTOPICREQ", "02 06", "WILLTOPICREQ"},
    {"WILLTOPIC-q1-retain-w/1", "06 07 30 77 2f 31", "WILLTOPIC qos=1 retain=1 topic=w/1"},
    {"WILLTOPIC-q0-w/1", "06 07 00 77 2f 31", "WILLTOPIC qos=0 retain=0 topic=w/1"},
    {"WILLTOPIC-q2-w/1", "06 07 40 77 2f 31", "WILLTOPIC qos=2 retain=0 topic=w/1"},
    {"WILLTOPIC-empty", "02 07", "WILLTOPIC none"},
    {"WILLMSGREQ", "02 08", "WILLMSGREQ"},
    {"WILLMSG-dead", "06 09 64 65 61 64", "WILLMSG message=64656164"},
    {"WILLMSG-empty", "02 09", "WILLMSG message="},
    {"REGISTER-from-client-a/b", "09 0a 00 00 00 01 61 2f 62", "REGISTER id=0 msg=1 topic=a/b"},
    {"REGISTER-from-gw-id5-a/b", "09 0a 00 05 12 34 61 2f 62", "REGISTER id=5 msg=4660 topic=a/b"},
    {"REGACK-ok", "07 0b 00 05 00 01 00", "REGACK id=5 msg=1 code=0"},
    {"REGACK-congestion", "07 0b 00 00 00 01 01", "REGACK id=0 msg=1 code=1"},
    {"REGACK-invalid-topic", "07 0b 00 05 12 34 02", "REGACK id=5 msg=4660 code=2"},
    {"REGACK-notsupported", "07 0b 00 00 00 01 03", "REGACK id=0 msg=1 code=3"},
    {"PUBLISH-q0-normal-id5-hi", "09 0c 00 00 05 00 00 68 69",
     "PUBLISH dup=0 qos=0 retain=0 normal id=5 msg=0 data=6869"},
    {"PUBLISH-q1-normal-id5-mid1-hi", "09 0c 20 00 05 00 01 68 69",
     "PUBLISH dup=0 qos=1 retain=0 normal id=5 msg=1 data=6869"},
    {"PUBLISH-q1-dup", "09 0c a0 00 05 00 01 68 69",
     "PUBLISH dup=1 qos=1 retain=0 normal id=5 msg=1 data=6869"},
    {"PUBLISH-q2-normal", "09 0c 40 00 05 00 02 68 69",
     "PUBLISH dup=0 qos=2 retain=0 normal id=5 msg=2 data=6869"},
    {"PUBLISH-q2-dup", "09 0c c0 00 05 00 02 68 69",
     "PUBLISH dup=1 qos=2 retain=0 normal id=5 msg=2 data=6869"},
    {"PUBLISH-q0-retain", "09 0c 10 00 05 00 00 68 69",
     "PUBLISH dup=0 qos=0 retain=1 normal id=5 msg=0 data=6869"},
    {"PUBLISH-q0-predef-id7", "09 0c 01 00 07 00 00 68 69",
     "PUBLISH dup=0 qos=0 retain=0 predefined id=7 msg=0 data=6869"},
    {"PUBLISH-q1-predef-id7", "09 0c 21 00 07 00 03 68 69",
     "PUBLISH dup=0 qos=1 retain=0 predefined id=7 msg=3 data=6869"},
    {"PUBLISH-q0-short-ab", "09 0c 02 61 62 00 00 68 69",
     "PUBLISH dup=0 qos=0 retain=0 short id=24930 msg=0 data=6869"},
    {"PUBLISH-qm1-predef-id7", "09 0c 61 00 07 00 00 68 69",
     "PUBLISH dup=0 qos=-1 retain=0 predefined id=7 msg=0 data=6869"},
    {"PUBLISH-qm1-short-ab", "09 0c 62 61 62 00 00 68 69",
     "PUBLISH dup=0 qos=-1 retain=0 short id=24930 msg=0 data=6869"},
    {"PUBLISH-qm1-short-retain", "09 0c 72 61 62 00 00 68 69",
     "PUBLISH dup=0 qos=-1 retain=1 short id=24930 msg=0 data=6869"},
    {"PUBLISH-qm1-normal-ILLEGAL", "09 0c 60 00 05 00 00 68 69",
     "PUBLISH dup=0 qos=-1 retain=0 normal id=5 msg=0 data=6869"},
    {"PUBLISH-q0-empty-payload", "07 0c 00 00 05 00 00",
     "PUBLISH dup=0 qos=0 retain=0 normal id=5 msg=0 data="},
    {"PUBLISH-q1-dup-retain-predef", "08 0c b1 00 07 00 09 21",
     "PUBLISH dup=1 qos=1 retain=1 predefined id=7 msg=9 data=21"},
    {"PUBACK-ok", "07 0d 00 05 00 01 00", "PUBACK id=5 msg=1 code=0"},
    {"PUBACK-congestion", "07 0d 00 05 00 01 01", "PUBACK id=5 msg=1 code=1"},
    {"PUBACK-invalid-topic", "07 0d 00 05 00 01 02", "PUBACK id=5 msg=1 code=2"},
    {"PUBACK-notsupported", "07 0d 00 05 00 00 03", "PUBACK id=5 msg=0 code=3"},
    {"PUBCOMP", "04 0e 00 02", "PUBCOMP msg=2"},
    {"PUBREC", "04 0f 00 02", "PUBREC msg=2"},
    {"PUBREL", "04 10 00 02", "PUBREL msg=2"},
    {"SUBSCRIBE-name-q1-a/b", "08 12 20 00 0a 61 2f 62",
     "SUBSCRIBE dup=0 qos=1 normal msg=10 topic=a/b"},
    {"SUBSCRIBE-name-q0-wild-a/#", "08 12 00 00 0b 61 2f 23",
     "SUBSCRIBE dup=0 qos=0 normal msg=11 topic=a/#"},
    {"SUBSCRIBE-name-q2-dup", "08 12 c0 00 0c 61 2f 62",
     "SUBSCRIBE dup=1 qos=2 normal msg=12 topic=a/b"},
    {"SUBSCRIBE-predef-id7-q1", "07 12 21 00 0d 00 07",
     "SUBSCRIBE dup=0 qos=1 predefined msg=13 id=7"},
    {"SUBSCRIBE-short-ab-q0", "07 12 02 00 0e 61 62",
     "SUBSCRIBE dup=0 qos=0 short msg=14 id=24930"},
    {"SUBACK-q1-id5", "08 13 20 00 05 00 0a 00", "SUBACK qos=1 id=5 msg=10 code=0"},
    {"SUBACK-wild-id0", "08 13 00 00 00 00 0b 00", "SUBACK qos=0 id=0 msg=11 code=0"},
    {"SUBACK-rejected-invalid", "08 13 00 00 00 00 0d 02", "SUBACK qos=0 id=0 msg=13 code=2"},
    {"SUBACK-rejected-notsupp", "08 13 00 00 00 00 0d 03", "SUBACK qos=0 id=0 msg=13 code=3"},
    {"UNSUBSCRIBE-name-a/b", "08 14 00 00 0f 61 2f 62", "UNSUBSCRIBE normal msg=15 topic=a/b"},
    {"UNSUBSCRIBE-predef-id7", "07 14 01 00 10 00 07", "UNSUBSCRIBE predefined msg=16 id=7"},
    {"UNSUBSCRIBE-short-ab", "07 14 02 00 11 61 62", "UNSUBSCRIBE short msg=17 id=24930"},
    {"UNSUBACK", "04 15 00 0f", "UNSUBACK msg=15"},
    {"PINGREQ-plain", "02 16", "PINGREQ client="},
    {"PINGREQ-clientid-r1", "04 16 72 31", "PINGREQ client=r1"},
    {"PINGRESP", "02 17", "PINGRESP"},
    {"DISCONNECT-plain", "02 18", "DISCONNECT plain"},
    {"DISCONNECT-sleep-300s", "04 18 01 2c", "DISCONNECT duration=300"},
    {"DISCONNECT-sleep-0s", "04 18 00 00", "DISCONNECT duration=0"},
    {"WILLTOPICUPD-q1-retain", "06 1a 30 77 2f 32", "WILLTOPICUPD qos=1 retain=1 topic=w/2"},
    {"WILLTOPICUPD-empty", "02 1a", "WILLTOPICUPD none"},
    {"WILLTOPICRESP-ok", "03 1b 00", "WILLTOPICRESP code=0"},
    {"WILLTOPICRESP-notsupp", "03 1b 03", "WILLTOPICRESP code=3"},
    {"WILLMSGUPD-gone", "06 1c 67 6f 6e 65", "WILLMSGUPD message=676f6e65"},
    {"WILLMSGRESP-ok", "03 1d 00", "WILLMSGRESP code=0"},
}};

/// `PUBLISH-q1-300byte-3octet`: this, then 291 octets a..z a..z ...
inline constexpr std::string_view long_publish_header = "01 01 2c 0c 20 00 05 00 20";
inline constexpr std::string_view long_publish_fields =
    "PUBLISH dup=0 qos=1 retain=0 normal id=5 msg=32 data=291 octets";

struct EncapsulationVector {
  std::string_view name;
  std::string_view wire;
  unsigned radius;
  std::string_view node_id;
  std::string_view fields;  ///< of the message inside; empty: invalid
};

inline constexpr std::array<EncapsulationVector, 4> encapsulation_vectors{{
    {"FWD-encap-connect-node-0A0B", "05 fe 00 0a 0b 08 04 04 01 00 3c 72 31", 0, "0a 0b",
     "CONNECT will=0 clean=1 protocol=1 duration=60 client=r1"},
    {"FWD-encap-connack-node-0A0B", "05 fe 00 0a 0b 03 05 00", 0, "0a 0b", "CONNACK code=0"},
    {"FWD-encap-gwinfo-radius1", "05 fe 01 0a 0b 03 02 01", 1, "0a 0b", "GWINFO gw=1 address="},
    {"FWD-encap-zero-len-node", "03 fe 00 03 01 01", 0, "", ""},
}};

/// No answer, no state, counted.
inline constexpr std::array<std::string_view, 32> invalid_datagrams{{
    "",
    "00",
    "01",
    "01 00",
    "01 00 03",
    "02",
    "03 16",
    "02 16 00",
    "01 00 02 16",
    "ff 0c 00",
    "03 04 00",
    "04 01 01 00",
    "02 01",
    "05 0c 00 00 05",
    "03 07 00",
    "03 18 00",
    "05 18 00 3c 00",
    "02 03",
    "02 11",
    "02 19",
    "02 1e",
    "02 fd",
    "02 ff",
    "02 fe",
    "03 fe 00",
    "05 fe 00 0a 0b",
    "05 fe 00 0a 0b 05 fe 00 0a 0b 02 16",
    "06 12 20 00 0a",
    "05 fe 00 0a 0b 03 16",
    "03 1a 00",
    "00 16",
    "06 0a 00 00 00 01",
}};

}  // namespace slamgw::mqttsn
