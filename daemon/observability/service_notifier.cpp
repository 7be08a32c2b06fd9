// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/service_notifier.hpp"

#include <fmt/format.h>
#include <systemd/sd-daemon.h>

#include <cstdlib>
#include <utility>

namespace slamgw {
namespace {

constexpr std::chrono::seconds status_interval{1};

std::optional<std::chrono::microseconds> half_of_watchdog() {
  std::uint64_t limit_us = 0;
  if (sd_watchdog_enabled(0, &limit_us) <= 0) return std::nullopt;
  return std::chrono::microseconds(limit_us / 2);
}

/// systemd 253 and later compare this time with the time of their request to reload.
std::int64_t monotonic_us() {
  const auto now = std::chrono::steady_clock::now().time_since_epoch();  // CLOCK_MONOTONIC
  return std::chrono::duration_cast<std::chrono::microseconds>(now).count();
}

std::string_view word(bool is_up) { return is_up ? "up" : "down"; }

}  // namespace

std::string service_status(const ServiceState& state, std::uint64_t messages_per_second) {
  std::string text = fmt::format("broker {}", word(state.broker_is_up));
  for (const Mesh mesh : all_meshes)
    if (const auto is_up = state.mesh_is_up[mesh])
      text += fmt::format(", {} {}", to_string(mesh), word(*is_up));
  return text +
         fmt::format(", {} robots online, {} msg/s", state.robots_online, messages_per_second);
}

ServiceNotifier::ServiceNotifier(boost::asio::io_context& io, std::function<ServiceState()> state)
    : watchdog_timer_(io),
      status_timer_(io),
      state_(std::move(state)),
      watchdog_interval_(half_of_watchdog()) {}

void ServiceNotifier::ready() {
  sd_notify(0, "READY=1");
  if (std::getenv("NOTIFY_SOCKET") == nullptr || std::exchange(is_running_, true)) return;
  const auto feed_watchdog = [] { sd_notify(0, "WATCHDOG=1"); };
  if (watchdog_interval_) {
    feed_watchdog();
    watchdog_timer_.every(*watchdog_interval_, feed_watchdog);
  }
  report_status();
  status_timer_.every(status_interval, [this] { report_status(); });
}

void ServiceNotifier::reloading() {
  sd_notify(0, fmt::format("RELOADING=1\nMONOTONIC_USEC={}", monotonic_us()).c_str());
}

void ServiceNotifier::stopping() {
  sd_notify(0, "STOPPING=1");
  is_running_ = false;
  watchdog_timer_.cancel();
  status_timer_.cancel();
}

void ServiceNotifier::report_status() {
  const ServiceState state = state_();
  const std::uint64_t before =
      std::exchange(messages_before_, state.messages).value_or(state.messages);
  std::string status = service_status(state, state.messages - before);
  if (status != last_status_) {
    last_status_ = std::move(status);
    sd_notify(0, ("STATUS=" + last_status_).c_str());
  }
}

}  // namespace slamgw
