// SPDX-License-Identifier: Apache-2.0
#include "daemon/delivery/connection_suspects.hpp"

#include <algorithm>
#include <iterator>

#include "daemon/core/spare_buffers.hpp"

namespace slamgw {

void ConnectionSuspects::on_written(std::uint64_t sequence, std::string topic) {
  written_.push_back({sequence, std::move(topic)});
  if (written_.size() > most_written) drop_oldest();
}

void ConnectionSuspects::on_answered(std::uint64_t sequence) {
  while (!written_.empty() && written_.front().sequence < sequence) drop_oldest();
}

void ConnectionSuspects::drop_oldest() {
  SpareBuffers<std::string>::give_back(std::move(written_.front().topic));
  written_.pop_front();
}

std::vector<std::string> ConnectionSuspects::on_loss(const OutboxEntries& unanswered,
                                                     TimePoint now) {
  std::set<std::string> topics;
  for (const OutboxEntry& entry : unanswered) topics.insert(entry.message.topic);
  for (Written& written : written_) topics.insert(std::move(written.topic));
  written_.clear();
  std::vector<std::string> suspects;
  if (now - last_loss_ <= longest_between)
    std::set_intersection(topics.begin(), topics.end(), last_unanswered_.begin(),
                          last_unanswered_.end(), std::back_inserter(suspects));
  last_unanswered_ = std::move(topics);
  last_loss_ = now;
  return suspects;
}

void ConnectionSuspects::on_link_up() {
  written_.clear();
  refused_.reset();
}

}  // namespace slamgw
