// SPDX-License-Identifier: Apache-2.0
// Robots' messages on their way through the outbox to a broker, with a store on disk, wired as in
// the daemon. For tests with real and with misbehaving brokers.
#pragma once

#include <gtest/gtest.h>

#include <map>
#include <string>
#include <vector>

#include "daemon/delivery/outbox.hpp"
#include "daemon/mqtt/upstream.hpp"
#include "daemon/runtime/machine_driver.hpp"
#include "daemon/storage/disk_store.hpp"
#include "tests/mqtt/broker_link.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw {

class DeliveryRig : private UpstreamListener {
 public:
  static constexpr std::size_t window = 16;

  /// `store`: a directory that outlives the rig, for a restart of the daemon; empty: its own.
  explicit DeliveryRig(BrokerSettings settings, std::string store = {})
      : store_directory_(store.empty() ? directory.path() : std::move(store)),
        outbox(window, store_settings().max_bytes),
        driver_(io, outbox,
                [this](OutboxAction& action) {
                  std::visit([this](auto& what) { perform(what); }, action);
                }),
        store_(
            io, store_settings(),
            [this](StoreEvent event) { driver_->on_store_event(std::move(event), read_clocks()); }),
        upstream_(io, std::move(settings),
                  ConnectionTraits{make_configured_link, {"gw/state", "offline"}}, *this) {
    store_.start();
    upstream_.start();
  }
  ~DeliveryRig() override {
    driver_.stop();
    upstream_.stop();
    store_.stop();
  }

  /// Submits a message whose payload is the number of its receipt.
  void submit(const std::string& topic, std::uint64_t number, Qos qos = Qos::at_least_once) {
    submit_bytes(topic, to_bytes(std::to_string(number)), number, qos);
  }
  void submit_bytes(const std::string& topic, Bytes payload, std::uint64_t receipt,
                    Qos qos = Qos::at_least_once) {
    driver_->submit({topic, std::move(payload), qos, false},
                    {Mesh::thread, qos == Qos::at_most_once ? 0 : receipt}, read_clocks());
  }
  void subscribe(const std::string& filter) { upstream_.subscribe(filter); }
  /// Returns how many messages the broker does not have: the depths of queue and store.
  std::size_t depth() const { return outbox.unsaved() + outbox.backlog().rows(); }
  bool sees(const std::function<bool()>& condition,
            std::chrono::milliseconds limit = test::patience) {
    return test::eventually(io, condition, limit);
  }
  bool logs(std::string_view words) const {
    for (const std::string& notice : notices) {
      if (notice.find(words) != std::string::npos) return true;
    }
    return false;
  }

  test::TempDir directory;

 private:
  const std::string store_directory_;

 public:
  boost::asio::io_context io;
  Outbox outbox;
  bool is_up = false;
  std::size_t ups = 0;
  std::size_t silences = 0;
  std::vector<std::string> reasons;  ///< why the link went down
  std::map<std::uint64_t, ReceiptOutcome> fired;
  std::vector<std::string> notices;

 private:
  StoreSettings store_settings() const { return {store_directory_, 1u << 28}; }

  void perform(PublishAtBroker& publish) {
    const auto* message = outbox.under_way(publish.sequence);
    if (message) upstream_.publish(publish.sequence, *message, publish.is_trial);
  }
  void perform(FireReceipt& fire) { fired[fire.receipt.id] = fire.outcome; }
  void perform(WriteToStore& write) { store_.ask(std::move(write)); }
  void perform(LoadFromStore& load) { store_.ask(std::move(load)); }
  void perform(RetryDeadLetters& retry) { store_.ask(std::move(retry)); }
  void perform(MessageStep&) {}
  void perform(Notice& notice) { notices.push_back(notice.text); }

  void on_link_up(const BrokerLimits& limits) override {
    is_up = true;
    ++ups;
    driver_->on_link_up(limits.receive_maximum, read_clocks());
  }
  void on_link_down(const std::string& why) override {
    is_up = false;
    reasons.push_back(why);
    driver_->on_link_down(read_clocks());
  }
  void on_link_left(const std::string&) override {
    is_up = false;
    driver_->on_link_left(read_clocks());
  }
  void on_silence(bool is_silent) override {
    silences += is_silent ? 1 : 0;
    driver_->on_silence(is_silent, read_clocks());
  }
  void on_published(std::uint64_t sequence) override {
    driver_->on_published(sequence, read_clocks());
  }
  void on_publish_refused(std::uint64_t sequence, const Refusal& refusal) override {
    driver_->on_publish_refused(sequence, refusal, read_clocks());
  }
  void on_subscribe_result(const std::string&, bool) override {}
  void on_message(BrokerMessage, const UserProperties&) override {}

  MachineDriver<Outbox> driver_;
  DiskStore store_;
  Upstream upstream_;
};

}  // namespace slamgw
