// SPDX-License-Identifier: Apache-2.0
// Upstream against a real Mosquitto, with each client library.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <map>
#include <mutex>
#include <set>
#include <thread>

#include "tests/mqtt/broker_link.hpp"
#include "tests/support/certificates.hpp"
#include "tests/support/fake_broker.hpp"
#include "tests/support/free_port.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;
using test::eventually;
using test::FakeBroker;
using test::Mosquitto;
using test::Subscriber;

using UpstreamOf = WithEachClientAndVersion;
INSTANTIATE_TEST_SUITE_P(Over, UpstreamOf, testing::Combine(each_client, either_version),
                         UpstreamOf::name);
using Upstreams = WithEachClient;
INSTANTIATE_TEST_SUITE_P(Over, Upstreams, each_client, Upstreams::name);

TEST_P(UpstreamOf, PublishesAtEachQosAndReportsEachAcknowledgement) {
  BrokerOfVersion broker(version());
  const Subscriber subscriber(broker, "t/#", "%t %q %r %p", "mqttv5",
                              {"-q", "2", "--retain-as-published"});
  Link link(settings_for(broker.link_port()));
  ASSERT_TRUE(link.comes_up());
  EXPECT_EQ(link.upstream->version(), version());
  EXPECT_EQ(link.listener.limits.receive_maximum, version() == MqttVersion::v5 ? 20 : 65535)
      << "Mosquitto's default; MQTT 3.1.1 has none";
  std::vector<std::string> expected;
  std::set<std::uint64_t> sequences;
  for (std::uint64_t i = 0; i < 6; ++i) {
    const Qos qos = static_cast<Qos>(i / 2);
    const bool retain = i % 2 == 1;
    link.upstream->publish(i,
                           {fmt::format("t/{}", i), to_bytes(fmt::format("p{}", i)), qos, retain});
    expected.push_back(fmt::format("t/{} {} {:d} p{}", i, i / 2, retain, i));
    sequences.insert(i);
  }
  EXPECT_TRUE(link.sees([&] { return link.listener.published == sequences; }));
  EXPECT_TRUE(link.sees([&] { return subscriber.lines().size() == expected.size(); }));
  auto lines = subscriber.lines();
  std::ranges::sort(lines);
  EXPECT_EQ(lines, expected);
}

TEST_P(UpstreamOf, ReportsEachOfManyMessagesAsPublishedAndKeepsTheirOrder) {
  BrokerOfVersion broker(version());
  Subscriber subscriber(broker, "t", "%p");
  Link link(settings_for(broker.link_port()));
  ASSERT_TRUE(link.comes_up());
  constexpr std::uint64_t count = 250;  // Paho buffers 512
  std::vector<std::string> expected;
  for (std::uint64_t i = 0; i < count; ++i) {
    expected.push_back(std::to_string(i));
    // No more of QoS 1 than the broker sends to a subscriber at once, or others would overtake
    // them.
    const Qos qos = i % 20 == 19 ? Qos::at_least_once : Qos::at_most_once;
    link.upstream->publish(i, {"t", to_bytes(expected.back()), qos, false});
  }
  EXPECT_TRUE(link.sees([&] { return link.listener.published.size() == count; }));
  EXPECT_TRUE(link.sees([&] { return subscriber.lines().size() == count; }));
  EXPECT_EQ(subscriber.lines(), expected);
}

TEST_P(UpstreamOf, ReceivesOnlyMessagesOfItsSubscriptions) {
  BrokerOfVersion broker(version());
  test::mosquitto_publish(broker, {"-r", "-t", "down/kept", "-m", "old"});
  Link link(settings_for(broker.link_port()));
  ASSERT_TRUE(link.comes_up());
  link.upstream->subscribe("down/#");
  ASSERT_TRUE(link.sees([&] { return link.listener.messages.size() == 1; }));
  EXPECT_TRUE(link.listener.subscribed["down/#"]);
  EXPECT_TRUE(link.listener.messages[0].retain);

  link.upstream->subscribe("down/#");
  ASSERT_TRUE(link.sees([&] { return link.listener.messages.size() == 2; }))
      << "a repeated subscription brings retained messages again";

  test::mosquitto_publish(broker, {"-q", "1", "-t", "down/new", "-m", "x"});
  ASSERT_TRUE(link.sees([&] { return link.listener.messages.size() == 3; }));
  EXPECT_FALSE(link.listener.messages[2].retain);
  EXPECT_EQ(link.listener.messages[2].topic, "down/new");

  link.upstream->unsubscribe("down/#");
  link.upstream->subscribe("other");
  ASSERT_TRUE(link.sees([&] { return link.listener.subscribed.contains("other"); }));
  test::mosquitto_publish(broker, {"-t", "down/new", "-m", "unheard"});
  test::mosquitto_publish(broker, {"-t", "other", "-m", "heard"});
  ASSERT_TRUE(link.sees([&] { return link.listener.messages.size() == 4; }));
  EXPECT_EQ(link.listener.messages[3].topic, "other");
}

TEST_P(UpstreamOf, ReconnectsAfterTheBrokerWasKilled) {
  BrokerOfVersion broker(version());
  Link link(settings_for(broker.link_port()));
  ASSERT_TRUE(link.comes_up());
  broker.kill();
  ASSERT_TRUE(link.sees([&] { return !link.listener.is_up; }));
  broker.start();
  ASSERT_TRUE(link.comes_up());
  EXPECT_EQ(link.listener.ups, 2);
  link.upstream->publish(9, {"t", to_bytes("again"), Qos::at_least_once, false});
  EXPECT_TRUE(link.sees([&] { return link.listener.published.contains(9); }));
}

/// Connects with a clean start even when the broker's CONNACK announces a present session.
TEST_P(UpstreamOf, StartsACleanSessionWithEachConnection) {
  FakeBroker broker;
  std::mutex mutex;
  std::vector<bool> clean;  // of each connection that was taken
  broker.misbehave([&](FakeBroker::Connection& connection, const FakeBroker::Packet& packet) {
    if (packet.type() == FakeBroker::publish) {
      connection.close();
      return true;
    }
    if (packet.type() != FakeBroker::connect) return false;
    if (version() == MqttVersion::v3_1_1 && connection.is_v5()) {
      connection.send({0x20, 3, 0, 0x84, 0});
      connection.close();
      return true;
    }
    constexpr std::size_t flags_at = 7;  // MQTT 5 section 3.1.2
    constexpr std::uint8_t clean_start = 0x02;
    const std::scoped_lock lock(mutex);
    clean.push_back((packet.body.at(flags_at) & clean_start) != 0);
    connection.send(0x20,
                    connection.is_v5() ? FakeBroker::Octets{1, 0, 0} : FakeBroker::Octets{1, 0});
    return true;
  });
  Link link(settings_for(broker.port()));
  ASSERT_TRUE(link.comes_up());
  link.upstream->publish(1, {"t", to_bytes("x"), Qos::exactly_once, false});
  ASSERT_TRUE(link.sees([&] { return link.listener.ups == 2; }));
  EXPECT_FALSE(link.listener.published.contains(1)) << "the outbox sends it again";
  const std::scoped_lock lock(mutex);
  EXPECT_EQ(clean, (std::vector<bool>{true, true}));
}

TEST_P(UpstreamOf, SubscribesAtQos0AndReportsARefusal) {
  FakeBroker broker;
  std::mutex mutex;
  std::vector<int> asked;  // QoS, of each SUBSCRIBE for "f"
  broker.misbehave([&](FakeBroker::Connection& connection, const FakeBroker::Packet& packet) {
    if (packet.type() == FakeBroker::connect && version() == MqttVersion::v3_1_1 &&
        connection.is_v5()) {
      connection.send({0x20, 3, 0, 0x84, 0});
      connection.close();
      return true;
    }
    if (packet.type() != FakeBroker::subscribe || !packet.contains("refused/f")) return false;
    constexpr std::uint8_t qos_bits = 0x03;
    const std::scoped_lock lock(mutex);
    asked.push_back(packet.body.back() & qos_bits);
    FakeBroker::Octets suback{packet.body.at(0), packet.body.at(1)};
    if (connection.is_v5()) suback.push_back(0);
    suback.push_back(connection.is_v5() ? 0x87 : 0x80);
    connection.send(0x90, suback);
    return true;
  });
  Link link(settings_for(broker.port()));
  ASSERT_TRUE(link.comes_up());
  link.upstream->subscribe("refused/f");
  ASSERT_TRUE(link.sees([&] { return link.listener.subscribed.contains("refused/f"); }));
  EXPECT_FALSE(link.listener.subscribed["refused/f"]);
  EXPECT_TRUE(link.listener.is_up);
  const std::scoped_lock lock(mutex);
  EXPECT_EQ(asked, std::vector<int>{0});
}

TEST_P(UpstreamOf, DoesNotReportALostConnectionAsARefusal) {
  BrokerOfVersion broker(version());
  Link link(settings_for(broker.link_port()));
  ASSERT_TRUE(link.comes_up());
  broker.pause();  // nothing is acknowledged
  for (std::uint64_t i = 1; i <= 12; ++i) {
    link.upstream->publish(i, {"t", to_bytes("x"), static_cast<Qos>(1 + i % 2), false});
  }
  link.upstream->subscribe("down/#");
  broker.kill();
  ASSERT_TRUE(link.sees([&] { return link.listener.reasons.size() >= 2; }));
  EXPECT_TRUE(link.listener.refused.empty()) << link.listener.refused.begin()->second.why;
  EXPECT_TRUE(link.listener.published.empty());
  EXPECT_TRUE(link.listener.subscribed.empty()) << "the subscription was not refused";
  for (const std::string& reason : link.listener.reasons) {
    EXPECT_EQ(reason.find("0xff"), std::string::npos) << reason;
  }
}

TEST_P(Upstreams, ReportsNoRivalClientWhenTheBrokerClosesAfterARefusal) {
  FakeBroker broker;
  broker.misbehave([](FakeBroker::Connection& connection, const FakeBroker::Packet& packet) {
    if (packet.type() != FakeBroker::publish) return false;
    constexpr std::size_t id_at = 3;  // behind the topic, of one octet
    constexpr std::uint8_t not_authorised = 0x87;
    connection.send(FakeBroker::puback << 4,
                    {packet.body.at(id_at), packet.body.at(id_at + 1), not_authorised});
    connection.close();
    return true;
  });
  Link link(settings_for(broker.port()));
  for (std::uint64_t times = 1; times <= 5; ++times) {
    ASSERT_TRUE(link.comes_up());
    link.upstream->publish(times, {"t", to_bytes("x"), Qos::at_least_once, false});
    ASSERT_TRUE(link.sees([&] { return link.listener.reasons.size() == times; }));
    EXPECT_EQ(link.listener.refused.count(times), 1u);
    EXPECT_EQ(link.listener.reasons.back().find("another client"), std::string::npos)
        << link.listener.reasons.back();
  }
}

/// Some brokers close the connection at a SUBSCRIBE for which the gateway lacks the right.
TEST_P(Upstreams, ChecksThatTheBrokerAnswersWithoutAnyAccessRight) {
  FakeBroker broker;
  std::atomic<int> questions{0};
  broker.misbehave([&](FakeBroker::Connection& connection, const FakeBroker::Packet& packet) {
    if (packet.contains("slam-gateway/alive")) ++questions;
    if (packet.type() != FakeBroker::subscribe) return false;
    connection.close();
    return true;
  });
  Link link(settings_for(broker.port()));
  ASSERT_TRUE(link.comes_up());
  ASSERT_TRUE(link.sees([&] {
    link.upstream->publish(1, {"t", to_bytes("x"), Qos::at_most_once, false});
    return questions >= 3 || !link.listener.reasons.empty();  // each follows an answer
  }));
  EXPECT_TRUE(link.listener.reasons.empty()) << link.listener.reasons[0];
}

/// The broker acknowledges all messages but one, with others after it and without.
TEST_P(Upstreams, EndsTheConnectionWhenTheBrokerSkipsOneMessage) {
  for (const bool is_alone : {false, true}) {
    FakeBroker broker;
    broker.misbehave([](FakeBroker::Connection&, const FakeBroker::Packet& packet) {
      return packet.type() == FakeBroker::publish && packet.contains("lost");
    });
    BrokerSettings settings = settings_for(broker.port());
    settings.keep_alive = 5s;  // the interval of checks that it answers
    Link link(settings, {}, 2s);
    ASSERT_TRUE(link.comes_up());
    std::uint64_t number = 1;
    link.upstream->publish(number, {"t", to_bytes("lost"), Qos::at_least_once, false});
    ASSERT_TRUE(link.sees([&] {
      if (!is_alone && link.listener.published.size() + 1 == number)
        link.upstream->publish(++number, {"t", to_bytes("x"), Qos::at_least_once, false});
      return !link.listener.reasons.empty();
    }));
    EXPECT_EQ(link.listener.reasons[0],
              "the broker has not answered one message for 2 s, but has answered others");
    EXPECT_FALSE(link.listener.published.contains(1));
    EXPECT_EQ(link.listener.published.empty(), is_alone);
  }
}

TEST_P(Upstreams, WaitsForABrokerThatAnswersSlowlyButInOrder) {
  FakeBroker broker;
  broker.misbehave([](FakeBroker::Connection&, const FakeBroker::Packet& packet) {
    if (packet.type() == FakeBroker::publish) std::this_thread::sleep_for(500ms);
    return false;
  });
  Link link(settings_for(broker.port()), {}, 1s);
  ASSERT_TRUE(link.comes_up());
  for (std::uint64_t i = 1; i <= 6; ++i)
    link.upstream->publish(i, {"t", to_bytes("x"), Qos::at_least_once, false});
  ASSERT_TRUE(link.sees([&] { return link.listener.published.size() == 6; }));
  EXPECT_TRUE(link.listener.reasons.empty()) << link.listener.reasons[0];
}

TEST_P(Upstreams, RetriesUntilTheBrokerListens) {
  const std::uint16_t port = test::free_tcp_port();
  Link link(settings_for(port));
  ASSERT_TRUE(link.sees([&] { return link.listener.reasons.size() >= 2; })) << "keeps trying";
  EXPECT_NE(link.listener.reasons[0].find("Connection refused"), std::string::npos)
      << link.listener.reasons[0];
}

TEST_P(Upstreams, ReportsARefusedConnectionAndNoTlsError) {
  BrokerSettings settings = settings_for(test::free_tcp_port());
  settings.tls = true;
  Link link(settings);
  ASSERT_TRUE(link.sees([&] { return !link.listener.reasons.empty(); }));
  EXPECT_NE(link.listener.reasons[0].find("Connection refused"), std::string::npos)
      << link.listener.reasons[0];
}

TEST_P(Upstreams, ReportsAWrongPasswordWithoutShowingIt) {
  Mosquitto broker({}, "gw", "right");
  Link link(settings_for(broker.port(), Credentials{"gw", "s3cret-but-wrong"}));
  ASSERT_TRUE(link.sees([&] { return link.listener.reasons.size() >= 2; }));
  EXPECT_NE(link.listener.reasons[0].find("authorise"), std::string::npos)
      << link.listener.reasons[0];
  EXPECT_NE(link.listener.reasons[0].find("'gw'"), std::string::npos) << link.listener.reasons[0];
  EXPECT_EQ(link.listener.reasons[0].find("s3cret"), std::string::npos);

  Link right(settings_for(broker.port(), Credentials{"gw", "right"}));
  EXPECT_TRUE(right.comes_up());
}

TEST_P(Upstreams, FallsBackToMqtt311WhereTheBrokerRefusesMqtt5) {
  Mosquitto broker;
  test::Mqtt311Proxy old(broker.port());
  Link link(settings_for(old.port()));
  ASSERT_TRUE(link.comes_up());
  EXPECT_EQ(link.upstream->version(), MqttVersion::v3_1_1);
  EXPECT_EQ(old.turned_away(), 1u);
  EXPECT_TRUE(link.listener.reasons.empty()) << "the fallback is not reported";
}

TEST_P(Upstreams, FallsBackToMqtt311WhereTheBrokerClosesOnMqtt5) {
  Mosquitto broker;
  test::Mqtt311Proxy old(broker.port(), test::Mqtt311Proxy::Answer::close);
  Link link(settings_for(old.port()));
  ASSERT_TRUE(link.comes_up());
  EXPECT_EQ(link.upstream->version(), MqttVersion::v3_1_1);
  link.upstream->publish(1, {"t", to_bytes("x"), Qos::at_least_once, false});
  EXPECT_TRUE(link.sees([&] { return link.listener.published.contains(1); }));
}

/// RabbitMQ 3.10 answers QoS 2 with PUBACK, as QoS 1; libmosquitto ends the connection then.
TEST_P(Upstreams, UsesQos1WhereAnOldBrokerAnswersQos2WithAPuback) {
  FakeBroker broker;
  broker.misbehave([](FakeBroker::Connection& connection, const FakeBroker::Packet& packet) {
    if (packet.type() == FakeBroker::connect && connection.is_v5()) {
      connection.send(0x20, {0, 0x84, 0});
      connection.close();
      return true;
    }
    if (packet.type() != FakeBroker::publish || (packet.first >> 1 & 3) != 2) return false;
    const std::size_t id_at = 2 + packet.body[1];
    connection.send(0x40, {packet.body[id_at], packet.body[id_at + 1]});
    return true;
  });
  Link link(settings_for(broker.port()));
  ASSERT_TRUE(link.comes_up());
  link.upstream->publish(1, {"t", to_bytes("x"), Qos::exactly_once, false});
  if (GetParam() == MqttClient::paho) {
    EXPECT_TRUE(link.sees([&] { return link.listener.published.contains(1); }));
    return;
  }
  ASSERT_TRUE(link.sees([&] { return link.listener.ups == 2; }));
  EXPECT_NE(link.listener.reasons[0].find("QoS 1 is used instead"), std::string::npos)
      << link.listener.reasons[0];
  EXPECT_EQ(link.listener.limits.max_qos, Qos::at_least_once) << "the next line names it";
  link.upstream->publish(2, {"t", to_bytes("x"), Qos::exactly_once, false});
  EXPECT_TRUE(link.sees([&] { return link.listener.published.contains(2); }));
  EXPECT_EQ(link.listener.ups, 2);
}

TEST_P(Upstreams, SendsNoWildcardToABrokerThatTakesNone) {
  FakeBroker broker;
  std::atomic<int> wildcards{0};
  broker.misbehave([&](FakeBroker::Connection& connection, const FakeBroker::Packet& packet) {
    if (packet.type() == FakeBroker::subscribe && packet.contains("+")) ++wildcards;
    if (packet.type() != FakeBroker::connect) return false;
    connection.send(0x20, {0, 0, 2, 0x28, 0});
    return true;
  });
  Link link(settings_for(broker.port()));
  ASSERT_TRUE(link.comes_up());
  EXPECT_EQ(to_words(link.listener.limits), "no subscriptions with wildcards");
  link.upstream->subscribe("a/+");
  link.upstream->subscribe("a/b");
  EXPECT_TRUE(link.sees([&] { return link.listener.subscribed.size() == 2; }));
  EXPECT_EQ(link.listener.subscribed, (std::map<std::string, bool>{{"a/+", false}, {"a/b", true}}));
  EXPECT_EQ(wildcards, 0);
}

/// Returns a message whose PUBLISH has `packet_bytes` octets.
BrokerMessage message_of(std::size_t packet_bytes, Qos qos, std::size_t property_bytes) {
  BrokerMessage message{"t", {}, qos, false, Provenance{Mesh::thread, WallTime{}}};
  while (publish_packet_bytes(message, property_bytes) < packet_bytes)
    message.payload.push_back('x');
  return message;
}

TEST_P(Upstreams, PublishesUpToTheBrokersMaximumPacketSizeToTheOctet) {
  // With MQTT 5, Mosquitto closes the connection on a larger one.
  for (const std::uint32_t limit : {120u, 500u, 20000u}) {
    Mosquitto broker("max_packet_size " + std::to_string(limit));
    BrokerSettings settings = settings_for(broker.port());
    settings.gateway_id = "lab-1";
    Link link(settings);
    ASSERT_TRUE(link.comes_up());
    EXPECT_EQ(link.listener.limits.max_packet_bytes, limit);
    // Five for each pair's frame, and the texts.
    const std::size_t properties = 3 * 5 + std::string_view("meshthread").size() +
                                   std::string_view("gatewaylab-1").size() +
                                   std::string_view("received_at2025-11-21T04:40:00.042Z").size();
    std::uint64_t sequence = 0;
    for (const Qos qos : {Qos::at_most_once, Qos::at_least_once, Qos::exactly_once}) {
      link.upstream->publish(++sequence, message_of(limit, qos, properties));
      link.upstream->publish(++sequence, message_of(limit + 1, qos, properties));
    }
    ASSERT_TRUE(link.sees(
        [&] { return link.listener.published.size() == 3 && link.listener.refused.size() == 3; }));
    for (const std::uint64_t larger : {2u, 4u, 6u}) {
      EXPECT_EQ(link.listener.refused[larger].code, 0x95);
    }
    EXPECT_TRUE(link.listener.reasons.empty()) << link.listener.reasons[0];
  }
}

TEST_P(Upstreams, PublishesAtTheHighestQosThatTheBrokerSupports) {
  for (const int highest : {0, 1}) {
    Mosquitto broker("max_qos " + std::to_string(highest));
    Subscriber subscriber(broker, "t", "%q %p");
    Link link(settings_for(broker.port()));
    ASSERT_TRUE(link.comes_up());
    EXPECT_EQ(link.listener.limits.max_qos, static_cast<Qos>(highest));
    for (std::uint64_t qos = 0; qos <= 2; ++qos) {
      link.upstream->publish(qos + 1, {"t", to_bytes("x"), static_cast<Qos>(qos), false});
    }
    EXPECT_TRUE(link.sees([&] { return link.listener.published.size() == 3; }));
    EXPECT_TRUE(link.sees([&] { return subscriber.lines().size() == 3; }));
    EXPECT_EQ(link.listener.ups, 1);
  }
}

TEST_P(Upstreams, PublishesWithoutRetainWhereTheBrokerKeepsNoRetainedMessages) {
  Mosquitto broker("retain_available false");
  Subscriber subscriber(broker, "t", "%p");
  Link link(settings_for(broker.port()));
  ASSERT_TRUE(link.comes_up());
  EXPECT_FALSE(link.listener.limits.keeps_retained);
  link.upstream->publish(1, {"t", to_bytes("x"), Qos::at_least_once, true});
  EXPECT_TRUE(link.sees([&] { return link.listener.published.contains(1); }));
  EXPECT_TRUE(link.sees([&] { return subscriber.lines().size() == 1; }));
  EXPECT_TRUE(link.listener.reasons.empty()) << link.listener.reasons[0];
}

TEST_P(Upstreams, ChecksTheBrokersCertificateAndItsName) {
  const test::Certificates right("localhost");
  const test::Certificates stranger("localhost");
  const std::uint16_t tls_port = test::free_tcp_port();
  Mosquitto broker("listener " + std::to_string(tls_port) + " 127.0.0.1\ncertfile " +
                   right.certificate() + "\nkeyfile " + right.key());
  BrokerSettings settings = settings_for(tls_port);
  settings.tls = true;
  settings.host = "localhost";
  settings.ca_file = right.ca();
  Link good(settings);
  EXPECT_TRUE(good.comes_up());

  settings.host = "127.0.0.1";  // the certificate is for "localhost"
  Link wrong_name(settings);
  settings.host = "localhost";
  settings.ca_file = stranger.ca();
  Link wrong_authority(settings);
  const std::pair<Link*, const char*> bad[] = {
      {&wrong_name, "is not for '127.0.0.1'"},
      {&wrong_authority, "is not trusted (unable to get local issuer certificate)"}};
  for (const auto& [link, reason] : bad) {
    // Not always the first one: "localhost" may be ::1 first, where no broker listens.
    const auto is_reported = [reason = reason](const std::string& why) {
      return why.find(reason) != std::string::npos;
    };
    EXPECT_TRUE(link->sees([&, link = link] {
      return std::ranges::any_of(link->listener.reasons, is_reported);
    })) << reason;
    EXPECT_EQ(link->listener.ups, 0);
  }
}

TEST_P(Upstreams, ReportsThatTheBrokerRequiresAClientCertificate) {
  const test::Certificates right("localhost");
  const std::uint16_t tls_port = test::free_tcp_port();
  Mosquitto broker("listener " + std::to_string(tls_port) + " 127.0.0.1\ncertfile " +
                   right.certificate() + "\nkeyfile " + right.key() + "\ncafile " + right.ca() +
                   "\nrequire_certificate true");
  BrokerSettings settings = settings_for(tls_port);
  settings.tls = true;
  settings.host = "localhost";
  settings.ca_file = right.ca();
  Link without(settings);
  EXPECT_TRUE(without.sees([&] {  // its second listener may open late
    return std::ranges::any_of(without.listener.reasons, [](const std::string& reason) {
      return reason.find("broker.tls.certificate_file") != std::string::npos;
    });
  })) << testing::PrintToString(without.listener.reasons);
  settings.certificate_file = right.certificate();  // signed by the CA, good enough for a client
  settings.key_file = right.key();
  Link with(settings);
  EXPECT_TRUE(with.comes_up());
}

TEST_P(UpstreamOf, BrokerPublishesTheLastWillOfAKilledGateway) {
  BrokerOfVersion broker(version());
  Subscriber subscriber(broker, "gw/state", "%r %p");
  const pid_t child = fork();
  if (child == 0) {
    Link link(settings_for(broker.link_port()));
    link.comes_up();
    raise(SIGKILL);
  }
  int status = 0;
  waitpid(child, &status, 0);
  ASSERT_TRUE(eventually([&] { return subscriber.lines().size() == 1; }));
  EXPECT_EQ(subscriber.lines()[0], R"(0 {"state":"offline"})");
}

TEST_P(UpstreamOf, AnOrderlyStopPublishesNoWillAndLosesNothing) {
  BrokerOfVersion broker(version());
  Subscriber subscriber(broker, "#", "%t");
  Link link(settings_for(broker.link_port()));
  ASSERT_TRUE(link.comes_up());
  link.upstream->publish(1, {"last", to_bytes("x"), Qos::at_least_once, false});
  link.upstream->stop();
  ASSERT_TRUE(link.sees([&] { return !subscriber.lines().empty(); }));
  test::mosquitto_publish(broker, {"-t", "after", "-m", "x"});
  ASSERT_TRUE(link.sees([&] { return subscriber.lines().back() == "after"; }));
  EXPECT_EQ(subscriber.lines(), (std::vector<std::string>{"last", "after"}));
}

/// Does nothing: the test decides whether it connects.
struct FakeLink final : MqttLink {
  void connect() override {}
  void publish(std::uint64_t, const BrokerMessage&) override {}
  void subscribe(std::string) override {}
  void unsubscribe(std::string) override {}
  void abandon(bool) override {}
  std::uint64_t inbound_dropped() const override { return 0; }
};

TEST(Upstream, ConnectsOnceWhenTheNetworkChangesAsTheWaitEnds) {
  boost::asio::io_context io;
  RecordingListener listener;
  int links = 0;
  MqttLinkListener* upstream_side = nullptr;
  const auto make_link = [&](auto&, auto&, const LinkOptions&, MqttLinkListener& side) {
    ++links;
    upstream_side = &side;
    return std::make_shared<FakeLink>();
  };
  Upstream upstream(io, settings_for(1), {make_link}, listener);
  upstream.start();
  ASSERT_TRUE(eventually(io, [&] { return links == 1; }));
  upstream_side->on_connect_failed({});
  boost::asio::steady_timer network(io, std::chrono::milliseconds(0));
  network.async_wait([&](boost::system::error_code) { upstream.retry_now(); });
  const auto wait_is_over = std::chrono::steady_clock::now() + std::chrono::milliseconds(600);
  ASSERT_TRUE(eventually([&] { return std::chrono::steady_clock::now() > wait_is_over; }));
  EXPECT_TRUE(eventually(io, [&] { return links == 2; }));
  io.run();  // until no wait is left
  EXPECT_EQ(links, 2);
}

}  // namespace
}  // namespace slamgw
