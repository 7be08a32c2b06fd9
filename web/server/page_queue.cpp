// SPDX-License-Identifier: Apache-2.0
#include "web/server/page_queue.hpp"

#include "web/server/mirror.hpp"

namespace slamgw::web {
namespace {

/// Unlike a state, this does not come again: it is sent once for each connection.
constexpr std::string_view past = "$web/past";

/// The bytes of one entry, with the containers' share.
std::size_t cost_of(std::string_view topic, const std::string& text) {
  constexpr std::size_t entry_bytes = 200;
  return 2 * topic.size() + text.size() + entry_bytes;
}

}  // namespace

bool PageQueue::push_state(std::string_view topic, SharedText text) {
  const auto waiting = states_.find(topic);
  const std::size_t before = waiting == states_.end() ? 0 : cost_of(topic, *waiting->second);
  const std::size_t after = state_bytes_ - before + cost_of(topic, *text);
  if (after > max_state_bytes) return false;
  state_bytes_ = after;
  if (waiting != states_.end()) {
    waiting->second = std::move(text);
    return true;
  }
  order_.emplace_back(topic);
  states_.emplace(topic, std::move(text));
  return true;
}

void PageQueue::reset(std::string_view topic, SharedText text) {
  std::erase_if(order_, [this](const std::string& waiting) {
    if (waiting.starts_with(past)) return false;
    const auto state = states_.find(waiting);
    state_bytes_ -= cost_of(waiting, *state->second);
    states_.erase(state);
    return true;
  });
  push_state(topic, std::move(text));
}

std::uint64_t PageQueue::push_event(SharedText text) {
  const std::uint64_t before = unreported_drops_;
  event_bytes_ += text->size();
  events_.push_back(std::move(text));
  while (event_bytes_ > max_event_bytes && events_.size() > 1) {
    event_bytes_ -= events_.front()->size();
    events_.pop_front();
    ++unreported_drops_;
  }
  return unreported_drops_ - before;
}

SharedText PageQueue::pop() {
  if (unreported_drops_ > 0) {
    const std::string count = R"({"messages":)" + std::to_string(unreported_drops_) + "}";
    unreported_drops_ = 0;
    return std::make_shared<const std::string>(own_message("dropped", count));
  }
  if (!order_.empty()) {
    const auto state = states_.find(order_.front());
    SharedText text = std::move(state->second);
    state_bytes_ -= cost_of(state->first, *text);
    states_.erase(state);
    order_.pop_front();
    return text;
  }
  if (events_.empty()) return nullptr;
  SharedText text = std::move(events_.front());
  events_.pop_front();
  event_bytes_ -= text->size();
  return text;
}

std::string PageQueue::take() {
  std::string lines;
  while (lines.size() < enough_bytes) {
    const SharedText text = pop();
    if (!text) break;
    if (!lines.empty()) lines += '\n';
    lines += *text;
  }
  return lines;
}

}  // namespace slamgw::web
