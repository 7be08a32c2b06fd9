// SPDX-License-Identifier: Apache-2.0
// An outbox between robots, a broker and a store, on a virtual clock: verbs for tests, and what
// each side has received. Messages carry their number as payload.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "daemon/delivery/outbox.hpp"
#include "tests/delivery/fake_store.hpp"

namespace slamgw::test {

class OutboxRig {
 public:
  static constexpr std::size_t window = 16;
  static constexpr int topic_name_invalid = 0x90;

  explicit OutboxRig(std::uint64_t store_max_bytes = 1u << 28) : max_bytes(store_max_bytes) {
    start();
  }

  // The process.
  void start() {
    outbox = std::make_unique<Outbox>(window, max_bytes);
    open_store();
  }
  /// Loses everything in memory, and the requests that the store has not served.
  void die() {
    store.on_process_died();
    under_way.clear();
    is_up = false;
    outbox.reset();
  }
  void open_store() {
    outbox->on_store_event(store.open(now), now);
    drain();
  }

  // Robots.
  void submit(const std::string& topic, std::uint64_t receipt, Qos qos = Qos::at_least_once) {
    submit_bytes(topic, to_bytes(std::to_string(receipt)), receipt, qos);
  }
  void submit_bytes(const std::string& topic, Bytes payload, std::uint64_t receipt,
                    Qos qos = Qos::at_least_once) {
    outbox->submit({topic, std::move(payload), qos, false, Provenance{Mesh::thread, {}}},
                   {Mesh::thread, receipt}, now);
    drain();
  }
  bool has_fired(std::uint64_t receipt, ReceiptOutcome outcome) {
    return fired[receipt] == std::vector{outcome};
  }

  // The broker.
  void link_up(std::uint16_t receive_maximum = 65535) {
    is_up = true;
    outbox->on_link_up(receive_maximum, now);
    drain();
  }
  /// Loses the connection. The broker has received the first `received_unacknowledged` messages
  /// under way; their acknowledgements are lost.
  void link_down(std::size_t received_unacknowledged = 0) {
    lose_answers(received_unacknowledged);
    outbox->on_link_down(now);
    drain();
    for (const RefusedTopic& refused : outbox->refused_topics().list(1000))
      refused_topics.insert(refused.topic);
  }
  /// Ends a good connection, as for another broker. `received_unacknowledged` as in link_down().
  void leave(std::size_t received_unacknowledged = 0) {
    lose_answers(received_unacknowledged);
    outbox->on_link_left(now);
    drain();
  }
  void acknowledge_first() { acknowledge(under_way.begin()); }
  /// Acknowledges QoS 1 first: QoS 2 takes a round trip longer, so later messages overtake it.
  void acknowledge_quickest() {
    const auto quick = std::ranges::find_if(under_way, [](const Published& published) {
      return published.message.qos != Qos::exactly_once;
    });
    acknowledge(quick == under_way.end() ? under_way.begin() : quick);
  }
  void acknowledge_all_but(const std::set<std::string>& topics) {
    const auto is_answered = [&](const Published& published) {
      return !topics.contains(published.message.topic);
    };
    for (auto next = std::ranges::find_if(under_way, is_answered); next != under_way.end();
         next = std::ranges::find_if(under_way, is_answered))
      acknowledge(next);
  }
  void acknowledge_all() {
    while (!under_way.empty()) acknowledge_first();
  }
  void refuse_first(int code = 0x87) {
    const std::uint64_t sequence = under_way.front().sequence;
    refused_topics.insert(under_way.front().message.topic);
    under_way.pop_front();
    outbox->on_publish_refused(sequence, {code, "some reason"}, now);
    drain();
  }
  void refuse_all(int code = 0x87) {
    while (!under_way.empty()) refuse_first(code);
  }
  /// Returns how many messages the broker does not have, as the status shows them: the depths of
  /// queue and store. A message that is being written counts in both.
  std::size_t depth() const { return outbox->unsaved() + outbox->backlog().rows(); }
  std::vector<std::string> received_of(const std::string& topic) const {
    const auto found = received.find(topic);
    return found == received.end() ? std::vector<std::string>{} : found->second;
  }

  // The store and time.
  /// Serves one request, if there is one.
  bool serve_store() {
    if (!store.is_asked()) return false;
    outbox->on_store_event(store.serve(now), now);
    outbox->on_store_event(DeadLettersChanged{store.count_dead_letters()}, now);
    drain();
    return true;
  }
  void pass(Duration time) {
    now += time;
    const auto due = outbox->deadline();
    if (!due || *due > now) return;
    outbox->on_deadline(now);
    drain();
    const auto next = outbox->deadline();
    EXPECT_TRUE(!next || *next > now) << "a deadline that was served is due again at once";
  }
  /// Lets broker and store work until nothing is left to do.
  void settle() {
    if (!is_up) link_up();
    for (int idle = 0; idle < 200; ++idle) {
      while (serve_store()) idle = 0;
      if (!under_way.empty()) idle = 0;
      acknowledge_all();
      pass(std::chrono::milliseconds{500});
    }
  }

  void drain() {
    while (auto action = outbox->next_action())
      std::visit([this](auto& a) { perform(a); }, *action);
    if (!is_store_quick) return;
    is_store_quick = false;
    while (serve_store()) {
    }
    is_store_quick = true;
  }

  TimePoint now{std::chrono::hours{1}};
  std::uint64_t max_bytes;
  FakeStore store;
  bool is_store_quick = false;  ///< the store serves each request at once
  std::unique_ptr<Outbox> outbox;
  bool is_up = false;
  struct Published {
    std::uint64_t sequence = 0;
    BrokerMessage message;
  };
  std::deque<Published> under_way;
  std::vector<std::string> published_topics;
  std::map<std::string, std::vector<std::string>> received;  ///< by topic, payloads as text
  std::map<std::uint64_t, std::vector<ReceiptOutcome>> fired;
  /// All topics that were ever refused, also with their flow. Their messages may overtake each
  /// other.
  std::set<std::string> refused_topics;
  std::vector<MessageStep> steps;
  std::vector<std::string> notices;

  static std::string number_in(const BrokerMessage& message) {
    return std::string(as_text(message.payload));
  }

 private:
  void lose_answers(std::size_t received) {
    for (std::size_t i = 0; i < std::min(received, under_way.size()); ++i)
      receive(under_way[i].message);
    under_way.clear();
    is_up = false;
  }
  void acknowledge(std::deque<Published>::iterator which) {
    const Published published = std::move(*which);
    under_way.erase(which);
    receive(published.message);
    outbox->on_published(published.sequence, now);
    drain();
  }
  void receive(const BrokerMessage& message) {
    received[message.topic].emplace_back(as_text(message.payload));
  }
  void perform(PublishAtBroker& publish) {
    const BrokerMessage* const message = outbox->under_way(publish.sequence);
    ASSERT_TRUE(message) << "it is not under way";
    published_topics.push_back(message->topic);
    under_way.push_back({publish.sequence, *message});
  }
  void perform(FireReceipt& fire) { fired[fire.receipt.id].push_back(fire.outcome); }
  void perform(WriteToStore& write) { store.ask(std::move(write)); }
  void perform(LoadFromStore& load) { store.ask(load); }
  void perform(RetryDeadLetters& retry) { store.ask(std::move(retry)); }
  void perform(MessageStep& step) { steps.push_back(std::move(step)); }
  void perform(Notice& notice) { notices.push_back(notice.text); }
};

}  // namespace slamgw::test
