// SPDX-License-Identifier: Apache-2.0
/// When frames get through on a CAN bus: the lowest identifier of those that wait, one at a time, never interrupted.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <queue>
#include <vector>

namespace inertiad {

/// Ends [N] of frames that wait from their release [N] on, last `took` [N], and win by priority [N] (less is first),
/// then by their place in the arguments; s. O(N log N).
inline std::vector<double> arbitrate(const std::vector<double>& release, const std::vector<std::int64_t>& priority,
                                     const std::vector<double>& took)
{
    const std::size_t n = release.size();
    std::vector<std::size_t> order(n);
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return release[a] < release[b]; });
    const auto later = [&](std::size_t a, std::size_t b) {
        return priority[a] != priority[b] ? priority[a] > priority[b] : a > b;
    };
    std::priority_queue<std::size_t, std::vector<std::size_t>, decltype(later)> waiting(later);
    std::vector<double> end(n);
    double idle_from = 0.0;
    for (std::size_t next = 0; next < n || !waiting.empty();) {
        if (waiting.empty()) { idle_from = std::max(idle_from, release[order[next]]); }
        for (; next < n && release[order[next]] <= idle_from; ++next) { waiting.push(order[next]); }
        const std::size_t winner = waiting.top();
        waiting.pop();
        end[winner] = idle_from += took[winner];
    }
    return end;
}

}  // namespace inertiad
