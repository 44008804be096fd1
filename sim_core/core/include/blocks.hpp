// The Hessian as 3 x 3 blocks of pairs of nodes, its lower half in the order in which nodes are eliminated.
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "small.hpp"

namespace thinshell {

// Where the block of a pair (a, b) is; `turned`: it is kept as that of (b, a).
struct Slot {
  int32_t at;
  bool turned;
};

class Blocks {
 public:
  explicit Blocks(const int32_t *rank, int nodes) : rank_(rank), partners_(nodes) {
    for (int i = 0; i < nodes; ++i) partners_[i].push_back(i);
  }

  // Let there always be a block of a pair.
  void couple(int a, int b) { partners_[later(a, b)].push_back(earlier(a, b)); }

  // All such pairs are known; `more`: pairs that have blocks for now.
  void lay_out(const std::vector<std::pair<int, int>> &more) {
    for (auto &row : partners_) ordered(row);
    std::vector<std::vector<int>> rows = partners_;
    for (const auto &[a, b] : more) rows[later(a, b)].push_back(earlier(a, b));
    start_.assign(1, 0);
    column_.clear();
    for (auto &row : rows) {
      ordered(row);
      column_.insert(column_.end(), row.begin(), row.end());
      start_.push_back(int(column_.size()));
    }
    value_.assign(9 * column_.size(), 0.0);
  }
  bool has(int a, int b) const {
    const auto [first, last] = row(later(a, b));
    return std::binary_search(first, last, earlier(a, b));
  }

  Slot slot(int a, int b) const {
    const int i = later(a, b);
    const auto [first, last] = row(i);
    return {int32_t(std::lower_bound(first, last, earlier(a, b)) - column_.begin()), i != a};
  }

  void clear() { std::fill(value_.begin(), value_.end(), 0.0); }
  double *block(int at) { return &value_[9 * std::size_t(at)]; }
  const double *block(int at) const { return &value_[9 * std::size_t(at)]; }
  int nodes() const { return int(start_.size()) - 1; }
  int begin(int row) const { return start_[row]; }
  int end(int row) const { return start_[row + 1]; }
  int column(int at) const { return column_[at]; }

  void add(Slot to, const Mat<double, 3, 3> &m) {
    double *out = block(to.at);
    if (to.turned) {
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) out[3 * j + i] += m(i, j);
    } else {
      for (int k = 0; k < 9; ++k) out[k] += m[k];
    }
  }
  void add_diagonal(Slot to, double value) {
    for (int k = 0; k < 9; k += 4) block(to.at)[k] += value;
  }

  // All entries (3 nodes, 3 nodes).
  void spread(double *out) const {
    const std::size_t width = 3 * std::size_t(nodes());
    for (int i = 0; i < nodes(); ++i)
      for (int k = start_[i]; k < start_[i + 1]; ++k)
        for (int p = 0; p < 3; ++p)
          for (int q = 0; q < 3; ++q) {
            const std::size_t row = 3 * std::size_t(i) + p, column = 3 * std::size_t(column_[k]) + q;
            out[row * width + column] = out[column * width + row] = block(k)[3 * p + q];
          }
  }

  // Let `multiply` know which nodes matter.
  void border(const std::vector<bool> &nodes) {
    border_.clear();
    for (int i = 0; i < int(nodes.size()); ++i)
      for (int k = start_[i]; k < start_[i + 1]; ++k)
        if (nodes[i] || nodes[column_[k]]) border_.push_back({k, i});
  }

  // out += A x of moves x of the border's nodes alone, or at these alone for any x, with `width` columns, innermost:
  // (nodes, 3, width) both.
  void multiply(const double *x, double *out, int width) const {
    for (const auto &[k, i] : border_) {
      const int j = column_[k];
      times(block(k), 3, 1, x + 3 * std::size_t(j) * width, out + 3 * std::size_t(i) * width, width);
      if (i != j) times(block(k), 1, 3, x + 3 * std::size_t(i) * width, out + 3 * std::size_t(j) * width, width);
    }
  }

 private:
  using At = std::vector<int>::const_iterator;

  static void ordered(std::vector<int> &row) {
    std::sort(row.begin(), row.end());
    row.erase(std::unique(row.begin(), row.end()), row.end());
  }
  std::pair<At, At> row(int i) const { return {column_.begin() + start_[i], column_.begin() + start_[i + 1]}; }
  int later(int a, int b) const { return rank_[a] >= rank_[b] ? a : b; }
  int earlier(int a, int b) const { return rank_[a] >= rank_[b] ? b : a; }

  static void times(const double *b, int by_row, int by_column, const double *__restrict x, double *__restrict out,
                    int width) {
    for (int r = 0; r < 3; ++r) {
      const double p = b[r * by_row], q = b[r * by_row + by_column], s = b[r * by_row + 2 * by_column];
      for (int c = 0; c < width; ++c) out[r * width + c] += p * x[c] + q * x[width + c] + s * x[2 * width + c];
    }
  }

  const int32_t *rank_;
  std::vector<std::vector<int>> partners_;
  std::vector<int> start_, column_;
  std::vector<std::pair<int, int>> border_;  // block and its row
  std::vector<double> value_;
};

}  // namespace thinshell
