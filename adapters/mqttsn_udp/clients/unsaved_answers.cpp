// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/unsaved_answers.hpp"

#include <iterator>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

void ChangedSessions::mark(const ClientSession& session) {
  if (client_ids_.size() < max_clients_ + limits::max_changed)
    client_ids_.insert(session.client_id);
}

std::vector<std::string> ChangedSessions::take(std::size_t max) {
  std::vector<std::string> ids;
  while (!client_ids_.empty() && ids.size() < max)
    ids.push_back(std::move(client_ids_.extract(client_ids_.begin()).value()));
  return ids;
}

bool UnsavedAnswers::take(SendDatagram& datagram, const std::string* client_id) {
  if (client_id && is_waiting_) {
    const bool is_open = batches_.size() > (is_saving_ ? 1 : 0) &&
                         batches_.back().client_ids.size() < limits::max_sessions_for_answers;
    if (!is_open) batches_.emplace_back();
    batches_.back().client_ids.insert(*client_id);
    last_of_[datagram.to] = first_ + batches_.size() - 1;
  }
  if (batches_.empty()) return false;
  const auto last = last_of_.find(datagram.to);
  if (last == last_of_.end()) return false;
  batches_[last->second - first_].datagrams.push_back(std::move(datagram));
  ++waiting_;
  return true;
}

bool UnsavedAnswers::is_full() const { return waiting_ >= limits::max_unsaved_answers; }

std::set<std::string> UnsavedAnswers::begin_save() {
  if (batches_.empty() || std::exchange(is_saving_, true)) return {};
  return batches_.front().client_ids;
}

std::vector<SendDatagram> UnsavedAnswers::on_saved() {
  is_waiting_ = true;
  if (!std::exchange(is_saving_, false)) return {};
  return take_first();
}

std::vector<SendDatagram> UnsavedAnswers::give_up() {
  is_waiting_ = is_saving_ = false;
  std::vector<SendDatagram> all;
  while (!batches_.empty()) {
    std::vector<SendDatagram> first = take_first();
    std::move(first.begin(), first.end(), std::back_inserter(all));
  }
  return all;
}

std::vector<SendDatagram> UnsavedAnswers::take_first() {
  std::vector<SendDatagram> freed = std::move(batches_.front().datagrams);
  batches_.pop_front();
  waiting_ -= freed.size();
  for (const SendDatagram& datagram : freed) {
    const auto last = last_of_.find(datagram.to);
    if (last != last_of_.end() && last->second == first_) last_of_.erase(last);
  }
  ++first_;
  return freed;
}

}  // namespace slamgw::mqttsn
