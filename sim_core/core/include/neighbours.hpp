// Which primitives may touch: pairs of points, edges or triangles, searched at the start of a step, in two rings.
//
// As sim_core/contact/broad_phase.py and neighbours.py, which say what is done and why: the inner ring is what the
// contact law looks at, the outer ring decides which nodes the Hessian couples, and both are cut out of a list that
// serves while primitives move. Pairs are named by keys, first member times number of second primitives plus second
// member, and are kept in the order of these, so that the same positions give the same bits. Here the pairs of spheres
// that are near are found by a sweep along the longest extent.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <iterator>
#include <utility>
#include <vector>

#include "elements.hpp"

namespace thinshell {

using Keys = std::vector<int64_t>;

// Points (with weights), edges or triangles: nodes (count, corners), weights the same, null where they are none.
class Primitives {
 public:
  Primitives(const int32_t *nodes, const double *weights, int count, int corners)
      : nodes_(nodes), weights_(weights), count_(count), corners_(corners) {
    for (int k = 0; k < count * corners; ++k)
      if (!weights || weights[k] != 0.0) members_.push_back(nodes[k]);
    std::sort(members_.begin(), members_.end());
    members_.erase(std::unique(members_.begin(), members_.end()), members_.end());
    for (int i = 0; weights && i < count; ++i) {
      double total = 0.0;
      for (int a = 0; a < corners; ++a) total += std::abs(weights[i * corners + a]);
      stretch_ = std::max(stretch_, total);
    }
  }

  int count() const { return count_; }
  int corners() const { return corners_; }
  int node(int i, int a) const { return nodes_[i * corners_ + a]; }
  const std::vector<int> &members() const { return members_; }
  // How many times further from a common mean than its nodes a point may move.
  double stretch() const { return stretch_; }

  // Middle of vectors (nodes, 3) at its nodes, and the largest distance from it; of a point its own value.
  Vec3 middle(const double *v, int i) const {
    Vec3 out{};
    for (int a = 0; a < corners_; ++a) out += (weights_ ? weights_[i * corners_ + a] : 1.0 / corners_) * point(v, node(i, a));
    return out;
  }
  double around(const double *v, int i, const Vec3 &middle) const {
    double out = 0.0;
    for (int a = 0; !weights_ && a < corners_; ++a) out = std::max(out, Vec3(point(v, node(i, a)) - middle).norm_sqr());
    return std::sqrt(out);
  }

 private:
  const int32_t *nodes_;
  const double *weights_;
  int count_, corners_;
  std::vector<int> members_;
  double stretch_ = 1.0;
};

// Candidates of one ordered pair of sets of primitives. `once`: both are the same, and every pair is listed once.
class Candidates {
 public:
  using Distance = std::function<double(const double *, int, int)>;  // of a pair where nodes are at x [m]

  Candidates(Primitives ours, Primitives theirs, bool once, Distance distance)
      : ours_(std::move(ours)), theirs_(std::move(theirs)), once_(once), distance_(std::move(distance)) {}

  const Keys &inner() const { return inner_; }
  const Keys &coupled() const { return coupled_; }
  int first(int64_t key) const { return int(key / theirs_.count()); }
  int second(int64_t key) const { return int(key % theirs_.count()); }

  // Look for pairs that come nearer than `reach` [m] while nodes move from `x` to `towards` or thereabouts, unless those
  // at hand do. `more`: keep those in addition to what is found. Whether the inner and the outer ring changed.
  struct Changed {
    bool inner, outer;
  };
  Changed search(const double *x, const double *towards, std::size_t size, double reach, double margin, bool more) {
    if (!searched_at_.empty() && reach_ == reach && surplus_ <= surplus * margin) {
      const double *at = searched_at_.data();
      const bool serves = std::max(approach(at, x), approach(at, towards)) <= surplus_;
      if (serves && !(wide_ && approach(x, towards) <= surplus_)) return {false, false};
    }
    searched_at_.assign(x, x + size);
    reach_ = reach;
    surplus_ = surplus * margin;
    margin_ = margin;
    Keys near = within(x, reach + margin), found, bound;
    for (int64_t key : near)
      if (gap(x, key) <= reach + surplus_) found.push_back(key);
    if (approach(x, towards) > surplus_) {
      bound = on_the_way(x, towards, reach);
      found = united(found, bound);
    }
    if (more) {
      found = united(found, inner_);
      bound = united(bound, inner_);
    }
    const std::size_t most = wider * (near.size() + bound.size()) + few;
    wide_ = found.size() > wider * near.size() + few;
    const bool inside = coupled_.size() <= most &&
                        std::includes(coupled_.begin(), coupled_.end(), found.begin(), found.end());
    inner_ = std::move(found);
    if (!inside) couple(x, towards, near, bound);
    return {true, !inside};
  }

  // Renew the outer ring, because the matrix changes its pattern anyway.
  void recouple(const double *x, const double *towards) { couple(x, towards, within(x, reach_ + margin_), inner_); }

  // Whether a pair that is no candidate may have come within reach on the way to `x`.
  bool outran(const double *x) const {
    if (searched_at_.empty() || approach(searched_at_.data(), x) <= surplus_) return false;
    const Keys met = on_the_way(searched_at_.data(), x, reach_);
    return !std::includes(inner_.begin(), inner_.end(), met.begin(), met.end());
  }

 private:
  static constexpr double surplus = 0.5, listed = 3.0, ahead = 6.0;
  static constexpr std::size_t wider = 2, few = 256;

  struct Sphere {
    Vec3 at;
    double radius;
  };

  static Keys united(const Keys &a, const Keys &b) {
    Keys out;
    std::set_union(a.begin(), a.end(), b.begin(), b.end(), std::back_inserter(out));
    return out;
  }

  double gap(const double *x, int64_t key) const { return distance_(x, first(key), second(key)); }

  // By how much, at most, any of ours came nearer to any of theirs: the largest moves of both from a common mean.
  double approach(const double *a, const double *b) const {
    auto mean = [&](const std::vector<int> &members) {
      Vec3 out{};
      for (int i : members) out += point(b, i) - point(a, i);
      return Vec3(out / double(std::max<std::size_t>(members.size(), 1)));
    };
    const Vec3 common = 0.5 * (mean(ours_.members()) + mean(theirs_.members()));
    auto farthest = [&](const std::vector<int> &members) {
      double out = 0.0;
      for (int i : members) out = std::max(out, Vec3(point(b, i) - point(a, i) - common).norm_sqr());
      return std::sqrt(out);
    };
    return ours_.stretch() * farthest(ours_.members()) + theirs_.stretch() * farthest(theirs_.members());
  }

  bool serves(const double *x, double reach) const {
    return !listed_at_.empty() && reach + approach(listed_at_.data(), x) <= listed_reach_;
  }

  // Pairs nearer than `reach` where nodes are at `x`; a list that does not serve is made anew.
  Keys within(const double *x, double reach) {
    if (!serves(x, reach)) {
      const double wide = reach + listed * margin_;
      listed_.clear();
      for (int64_t key : spheres_near(spheres(ours_, x), spheres(theirs_, x), wide))
        if (gap(x, key) <= wide) listed_.push_back(key);
      listed_at_.assign(x, x + searched_at_.size());
      listed_reach_ = wide;
    }
    Keys out;
    for (int64_t key : listed_)
      if (gap(x, key) <= reach) out.push_back(key);
    return out;
  }

  void couple(const double *x, const double *towards, const Keys &near, const Keys &needed) {
    std::vector<double> there(searched_at_.size());
    for (std::size_t k = 0; k < there.size(); ++k) there[k] = x[k] + ahead * (towards[k] - x[k]);
    Keys soon;
    for (int64_t key : listed_)
      if (gap(there.data(), key) <= reach_ + surplus_) soon.push_back(key);
    coupled_ = united(united(near, needed), united(soon, inner_));
  }

  // Pairs that may come nearer than `reach` while nodes move from `x` to `to`.
  Keys on_the_way(const double *x, const double *to, double reach) const {
    std::vector<double> move(searched_at_.size());
    for (std::size_t k = 0; k < move.size(); ++k) move[k] = to[k] - x[k];
    const std::vector<Sphere> ours = spheres(ours_, move.data()), theirs = spheres(theirs_, move.data());
    auto slack = [&](int i, int j) {
      return reach + ours[i].radius + theirs[j].radius + Vec3(ours[i].at - theirs[j].at).norm();
    };
    Keys found, out;
    if (serves(x, reach + approach(x, to))) {
      found = listed_;
    } else {
      std::vector<Sphere> a = spheres(ours_, x), b = spheres(theirs_, x);
      auto swell = [](std::vector<Sphere> &at, const std::vector<Sphere> &by) {
        for (std::size_t i = 0; i < at.size(); ++i) {
          at[i].at += 0.5 * by[i].at;
          at[i].radius += by[i].radius + 0.5 * by[i].at.norm();
        }
      };
      swell(a, ours);
      swell(b, theirs);
      found = spheres_near(a, b, reach);
    }
    for (int64_t key : found)
      if (gap(x, key) <= slack(first(key), second(key))) out.push_back(key);
    return out;
  }

  static std::vector<Sphere> spheres(const Primitives &of, const double *v) {
    std::vector<Sphere> out(of.count());
    for (int i = 0; i < of.count(); ++i) {
      out[i].at = of.middle(v, i);
      out[i].radius = of.around(v, i, out[i].at);
    }
    return out;
  }

  bool joined(int i, int j) const {
    for (int a = 0; a < ours_.corners(); ++a)
      for (int b = 0; b < theirs_.corners(); ++b)
        if (ours_.node(i, a) == theirs_.node(j, b)) return true;
    return false;
  }

  // Pairs whose spheres are nearer than `apart`.
  Keys spheres_near(const std::vector<Sphere> &a, const std::vector<Sphere> &b, double apart) const {
    Keys out;
    if (a.empty() || b.empty()) return out;
    Vec3 low = b[0].at, high = b[0].at;
    double largest = 0.0;
    for (const Sphere &s : b) {
      for (int k = 0; k < 3; ++k) {
        low[k] = std::min(low[k], s.at[k]);
        high[k] = std::max(high[k], s.at[k]);
      }
      largest = std::max(largest, s.radius);
    }
    int axis = 0;
    for (int k = 1; k < 3; ++k)
      if (high[k] - low[k] > high[axis] - low[axis]) axis = k;
    std::vector<int> order(b.size());
    for (std::size_t j = 0; j < b.size(); ++j) order[j] = int(j);
    std::sort(order.begin(), order.end(), [&](int p, int q) { return b[p].at[axis] < b[q].at[axis]; });
    for (int i = 0; i < int(a.size()); ++i) {
      const double reach = apart + a[i].radius + largest;
      auto at = std::lower_bound(order.begin(), order.end(), a[i].at[axis] - reach,
                                 [&](int j, double value) { return b[j].at[axis] < value; });
      for (; at != order.end() && b[*at].at[axis] <= a[i].at[axis] + reach; ++at) {
        const int j = *at;
        const double far = apart + a[i].radius + b[j].radius;
        if ((once_ && j <= i) || !(Vec3(a[i].at - b[j].at).norm_sqr() <= far * far) || joined(i, j)) continue;
        out.push_back(int64_t(i) * theirs_.count() + j);
      }
    }
    std::sort(out.begin(), out.end());
    return out;
  }

  Primitives ours_, theirs_;
  bool once_, wide_ = false;
  Distance distance_;
  Keys inner_, coupled_, listed_;
  std::vector<double> searched_at_, listed_at_;
  double reach_ = 0.0, surplus_ = 0.0, margin_ = 0.0, listed_reach_ = 0.0;
};

// Values of the Hessian of the contacts of one system at the pairs of nodes that they couple, in the table that the
// kernels write into (sim_core.kernels.add_block): of each pair the lower node's row, upper halves of diagonal blocks.
class PairTable {
 public:
  using Pair = std::pair<int, int>;

  // `pairs`: in any order and number. Nodes have their own blocks: the search in a row wants one entry at least.
  void lay_out(std::vector<Pair> pairs, int nodes) {
    for (std::size_t k = 0, count = pairs.size(); k < count; ++k) {
      Pair &p = pairs[k];
      if (p.first > p.second) std::swap(p.first, p.second);
      const auto [low, high] = p;
      pairs.push_back({low, low});
      pairs.push_back({high, high});
    }
    std::sort(pairs.begin(), pairs.end());
    pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
    start_.assign(nodes + 1, 0);
    column_.clear();
    place_.clear();
    for (const Pair &p : pairs) {
      ++start_[p.first + 1];
      place_.push_back(int(column_.size()));
      column_.push_back(p.second);
    }
    for (int i = 0; i < nodes; ++i) start_[i + 1] += start_[i];
    value_.assign(9 * column_.size(), 0.0);
    pairs_ = std::move(pairs);
  }
  const std::vector<Pair> &pairs() const { return pairs_; }

  void bind(const Blocks &h) {
    slots_.clear();
    for (const Pair &p : pairs_) slots_.push_back(h.slot(p.first, p.second));
  }
  void clear() { std::fill(value_.begin(), value_.end(), 0.0); }
  void add_to(Blocks &h) const {
    for (std::size_t k = 0; k < pairs_.size(); ++k) {
      const double *v = &value_[9 * k];
      Mat3 block{};
      std::copy(v, v + 9, block.a);
      if (pairs_[k].first == pairs_[k].second)
        for (int i = 0; i < 3; ++i)
          for (int j = 0; j < i; ++j) block(i, j) = block(j, i);
      h.add(slots_[k], block);
    }
  }

  View<const int, 1> start() const { return {start_.data(), start_.size()}; }
  View<const int, 1> column() const { return {column_.data(), column_.size()}; }
  View<const int, 1> place() const { return {place_.data(), place_.size()}; }
  View<double, 1> values() { return {value_.data(), value_.size()}; }
  bool empty() const { return pairs_.empty(); }

 private:
  std::vector<Pair> pairs_;
  std::vector<int> start_, column_, place_;
  std::vector<double> value_;
  std::vector<Slot> slots_;
};

}  // namespace thinshell
