// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/link_state.h"

#include <array>

#include <gtest/gtest.h>

namespace haarlight::firmware_iface {
namespace {

using enum LinkState;

struct Case {
  LinkState from;
  LinkEvent event;
  LinkState to_reopen;  ///< on a bus that reopens
  LinkState to_settle;  ///< on a bus that settles
};

constexpr Case kTable[] = {
    {closed, LinkEvent::opened, unknown, unknown},
    {closed, LinkEvent::resynchronised, closed, closed},
    {closed, LinkEvent::fault_gone, closed, closed},
    {closed, LinkEvent::fault_line, closed, closed},
    {closed, LinkEvent::doubt, closed, closed},
    {closed, LinkEvent::close, closed, closed},
    {unknown, LinkEvent::opened, unknown, unknown},
    {unknown, LinkEvent::resynchronised, up, up},
    {unknown, LinkEvent::fault_gone, lost, lost},
    {unknown, LinkEvent::fault_line, lost, unknown},
    {unknown, LinkEvent::doubt, unknown, unknown},
    {unknown, LinkEvent::close, closed, closed},
    {up, LinkEvent::opened, unknown, unknown},
    {up, LinkEvent::resynchronised, up, up},
    {up, LinkEvent::fault_gone, lost, lost},
    {up, LinkEvent::fault_line, lost, unknown},
    {up, LinkEvent::doubt, unknown, unknown},
    {up, LinkEvent::close, closed, closed},
    {lost, LinkEvent::opened, unknown, unknown},
    {lost, LinkEvent::resynchronised, lost, lost},
    {lost, LinkEvent::fault_gone, lost, lost},
    {lost, LinkEvent::fault_line, lost, lost},
    {lost, LinkEvent::doubt, lost, lost},
    {lost, LinkEvent::close, closed, closed},
};

TEST(LinkState, FollowsItsTable) {
  static_assert(std::size(kTable) == std::size_t{4} * 6);
  for (const Case& c : kTable) {
    SCOPED_TRACE(to_string(c.from));
    SCOPED_TRACE(static_cast<int>(c.event));
    EXPECT_EQ(next_link_state(c.from, c.event, BusRecovery::reopen), c.to_reopen);
    EXPECT_EQ(next_link_state(c.from, c.event, BusRecovery::settle), c.to_settle);
  }
}

TEST(LinkState, PausesDoubleUpToASecond) {
  using std::chrono::milliseconds;
  EXPECT_EQ(reopen_pause(0), milliseconds(0));
  EXPECT_EQ(reopen_pause(1), milliseconds(50));
  EXPECT_EQ(reopen_pause(4), milliseconds(400));
  EXPECT_EQ(reopen_pause(6), milliseconds(1000));
  EXPECT_EQ(reopen_pause(1'000'000), milliseconds(1000));
}

}  // namespace
}  // namespace haarlight::firmware_iface
