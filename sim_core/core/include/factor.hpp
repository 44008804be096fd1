// Factorisation of a sparse symmetric matrix: by supernodes (PARDISO of MKL, where the platform has it), or within its
// envelope, A = U^T D^-1 U with rows of U stored from the diagonal to the last entry that the factor fills, for narrow
// meshes, whose nodes are numbered along them. The pattern says which of the two is the faster.
//
// George & Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981, ch. 4 (envelope); rows of equal
// length, as the three components of a node have, are eliminated together.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <vector>

namespace thinshell {

class Envelope {
 public:
  // `last`: last column of each row that has an entry, at least the row itself.
  void lay_out(std::vector<int> last) {
    count_ = int(last.size());
    last_ = std::move(last);
    for (int i = 1; i < count_; ++i)
      if (last_[i - 1] >= i) last_[i] = std::max(last_[i], last_[i - 1]);
  }
  // Make room for the values.
  void allocate() {
    start_.assign(count_ + 1, 0);
    for (int i = 0; i < count_; ++i) start_[i + 1] = start_[i] + (last_[i] - i + 1);
    value_.assign(start_[count_], 0.0);
    inverse_.assign(count_, 0.0);
  }

  // Multiplications and additions of a factorisation.
  double flops() const {
    double out = 0.0;
    for (int i = 0; i < count_; ++i) out += double(last_[i] - i + 1) * (last_[i] - i + 2);
    return out;
  }
  // Place of an entry of the upper triangle, i <= j.
  std::size_t place(int i, int j) const { return start_[i] + (j - i); }
  void clear() { std::fill(value_.begin(), value_.end(), 0.0); }
  double &operator[](std::size_t k) { return value_[k]; }

  // Factorise in place. `definite`: give up at a pivot that is not positive. False too where a pivot vanishes.
  bool factorise(bool definite) {
    for (int j = 0; j < count_;) {
      const int last = last_[j];
      int group = 1;
      while (group < 4 && j + group < count_ && last_[j + group] == last && j + group <= last) ++group;
      double *row[4];
      for (int g = 0; g < group; ++g) {
        const int i = j + g;
        row[g] = &value_[start_[i]] - i;
        for (int h = 0; h < g; ++h) subtract(row[g], row[h], row[h][i] * inverse_[j + h], i, last);
        const double pivot = row[g][i];
        if (definite ? !(pivot > 0.0) : !(std::abs(pivot) > 0.0)) return false;
        inverse_[i] = 1.0 / pivot;
      }
      int k = j + group;
      if (group == 3)
        for (; k + 2 <= last; k += 3) subtract_three(row, &inverse_[j], k, last);
      for (; k <= last; ++k)
        for (int g = 0; g < group; ++g)
          subtract(&value_[start_[k]] - k, row[g], row[g][k] * inverse_[j + g], k, last);
      j += group;
    }
    return true;
  }

  // Solve in place for one right-hand side.
  void solve(double *b) const {
    for (int j = 0; j < count_; ++j) {
      subtract(b, &value_[start_[j]] - j, b[j] * inverse_[j], j + 1, last_[j]);
    }
    for (int j = count_ - 1; j >= 0; --j) {
      const double *row = &value_[start_[j]] - j;
      double total = 0.0;
#pragma omp simd reduction(+ : total)
      for (int k = j + 1; k <= last_[j]; ++k) total += row[k] * b[k];
      b[j] = (b[j] - total) * inverse_[j];
    }
  }

  // Solve in place for `width` right-hand sides (count, width).
  void solve(double *b, int width) const {
    for (int j = 0; j < count_; ++j) {
      const double *row = &value_[start_[j]] - j, *from = b + std::size_t(j) * width;
      for (int k = j + 1; k <= last_[j]; ++k) {
        subtract(b + std::size_t(k) * width, from, row[k] * inverse_[j], 0, width - 1);
      }
    }
    for (int j = count_ - 1; j >= 0; --j) {
      const double *row = &value_[start_[j]] - j;
      double *to = b + std::size_t(j) * width;
      for (int k = j + 1; k <= last_[j]; ++k) {
        subtract(to, b + std::size_t(k) * width, row[k], 0, width - 1);
      }
      for (int p = 0; p < width; ++p) to[p] *= inverse_[j];
    }
  }

 private:
  static void subtract(double *__restrict to, const double *__restrict row, double factor, int begin, int last) {
    for (int m = begin; m <= last; ++m) to[m] -= factor * row[m];
  }
  // What three rows, with the inverses of their pivots, take from three others.
  void subtract_three(double *const *row, const double *inverse, int k, int last) {
    double f[3][3];
    for (int g = 0; g < 3; ++g)
      for (int i = 0; i < 3; ++i) f[i][g] = row[g][k + i] * inverse[g];
    double *const to[3] = {&value_[start_[k]] - k, &value_[start_[k + 1]] - k - 1, &value_[start_[k + 2]] - k - 2};
    for (int i = 0; i < 2; ++i)
      for (int m = k + i; m < k + 2; ++m)
        to[i][m] -= f[i][0] * row[0][m] + f[i][1] * row[1][m] + f[i][2] * row[2][m];
    multiply_three(to[0], to[1], to[2], row[0], row[1], row[2], f, k + 2, last);
  }
  static void multiply_three(double *__restrict x, double *__restrict y, double *__restrict z,
                             const double *__restrict p, const double *__restrict q, const double *__restrict r,
                             const double (&f)[3][3], int begin, int last) {
    for (int m = begin; m <= last; ++m) {
      const double a = p[m], b = q[m], c = r[m];
      x[m] -= f[0][0] * a + f[0][1] * b + f[0][2] * c;
      y[m] -= f[1][0] * a + f[1][1] * b + f[1][2] * c;
      z[m] -= f[2][0] * a + f[2][1] * b + f[2][2] * c;
    }
  }

  int count_ = 0;
  std::vector<int> last_;
  std::vector<std::size_t> start_;
  std::vector<double> value_, inverse_;
};

// `pardiso_64` of MKL; null: the platform has none.
using PardisoFunction = void (*)(void *handle, const int64_t *maxfct, const int64_t *mnum, const int64_t *mtype,
                                 const int64_t *phase, const int64_t *n, const void *a, const int64_t *ia,
                                 const int64_t *ja, int64_t *perm, const int64_t *nrhs, int64_t *iparm,
                                 const int64_t *msglvl, void *b, void *x, int64_t *error);
inline PardisoFunction pardiso_function = nullptr;

// One matrix type of one pattern: rows of the upper triangle, columns in order.
class Pardiso {
 public:
  Pardiso() = default;
  Pardiso(const Pardiso &) = delete;
  Pardiso &operator=(const Pardiso &) = delete;
  ~Pardiso() { release(); }

  // Analyse a pattern that lives as long as this; false where that fails.
  bool analyse(bool definite, const std::vector<int64_t> &start, const std::vector<int64_t> &column) {
    release();
    start_ = &start;
    column_ = &column;
    count_ = int64_t(start.size()) - 1;
    kind_ = definite ? 2 : -2;
    std::fill(std::begin(handle_), std::end(handle_), nullptr);
    std::fill(std::begin(iparm_), std::end(iparm_), 0);
    iparm_[0] = 1;   // what follows is set, not as MKL likes
    iparm_[1] = 2;   // nested dissection
    iparm_[9] = 8;   // pivots of an indefinite matrix are perturbed at 1e-8
    iparm_[18] = -1; // count flops
    iparm_[20] = 1;  // 1 x 1 and 2 x 2 pivots
    iparm_[34] = 1;  // indices from zero
    analysed_ = true;
    return call(11, nullptr, 0, nullptr, nullptr) == 0;
  }
  // Multiplications and additions of a factorisation.
  double flops() const { return 1e6 * double(iparm_[18]); }
  bool known() const { return analysed_; }

  bool factorise(const double *values) {
    values_ = values;
    return call(22, values, 0, nullptr, nullptr) == 0;
  }
  // For `width` right-hand sides, column by column.
  void solve(double *b, double *x, int width) const { call(33, values_, width, b, x); }

  void release() {
    if (analysed_) call(-1, nullptr, 0, nullptr, nullptr);
    analysed_ = false;
  }

 private:
  int64_t call(int64_t phase, const double *values, int64_t width, double *b, double *x) const {
    const int64_t one = 1, quiet = 0;
    int64_t error = 0;
    pardiso_function(handle_, &one, &one, &kind_, &phase, &count_, values, start_->data(), column_->data(), nullptr,
                     &width, iparm_, &quiet, b, x, &error);
    return error;
  }

  const std::vector<int64_t> *start_ = nullptr, *column_ = nullptr;
  const double *values_ = nullptr;
  int64_t count_ = 0, kind_ = 2;
  bool analysed_ = false;
  mutable void *handle_[64];
  mutable int64_t iparm_[64];
};

class Factor {
 public:
  // `rows`: columns of the entries of the upper triangle by rows, in order, the diagonal first. Places of entries hold
  // until it is called again.
  void lay_out(const std::vector<std::vector<int>> &rows) {
    std::vector<int> last;
    start_.assign(1, 0);
    column_.clear();
    for (const auto &row : rows) {
      last.push_back(row.back());
      column_.insert(column_.end(), row.begin(), row.end());
      start_.push_back(int64_t(column_.size()));
    }
    envelope_.lay_out(std::move(last));
    indefinite_.release();
    supernodes_ = pardiso_function && !rows.empty() && envelope_.flops() > calls &&
                  supernodal_.analyse(true, start_, column_) && supernodal_.flops() + calls < envelope_.flops();
    if (supernodes_) {
      value_.assign(column_.size(), 0.0);
    } else {
      supernodal_.release();
      envelope_.allocate();
    }
  }

  bool by_supernodes() const { return supernodes_; }
  // Place of an entry of the upper triangle, i <= j.
  std::size_t place(int i, int j) const {
    if (!supernodes_) return envelope_.place(i, j);
    const auto first = column_.begin() + start_[i], last = column_.begin() + start_[i + 1];
    return std::size_t(std::lower_bound(first, last, j) - column_.begin());
  }
  void clear() {
    if (supernodes_) std::fill(value_.begin(), value_.end(), 0.0);
    else envelope_.clear();
  }
  double &operator[](std::size_t k) { return supernodes_ ? value_[k] : envelope_[k]; }

  // Factorise what was put in place. `definite`: give up where the matrix is not. False too where a pivot vanishes.
  bool factorise(bool definite) {
    if (!supernodes_) return envelope_.factorise(definite);
    if (!definite && !indefinite_.known() && !indefinite_.analyse(false, start_, column_)) return false;
    used_ = definite ? &supernodal_ : &indefinite_;
    return used_->factorise(value_.data());
  }

  // Solve in place for `width` right-hand sides (count, width).
  void solve(double *b, int width = 1) const {
    if (!supernodes_) {
      if (width == 1) envelope_.solve(b);
      else envelope_.solve(b, width);
      return;
    }
    const std::size_t count = start_.size() - 1, size = count * width;
    given_.resize(size);
    found_.resize(size);
    for (std::size_t k = 0; k < count; ++k)
      for (int c = 0; c < width; ++c) given_[c * count + k] = b[k * width + c];
    used_->solve(given_.data(), found_.data(), width);
    for (std::size_t k = 0; k < count; ++k)
      for (int c = 0; c < width; ++c) b[k * width + c] = found_[c * count + k];
  }

 private:
  // What calls of the library cost, in flops of the envelope: both take as long at 1e5 of these (gels of 84 unknowns),
  // and at 5e5 the envelope takes 4 % longer (docs/design/compiled_core.md).
  static constexpr double calls = 2e5;

  Envelope envelope_;
  Pardiso supernodal_, indefinite_;
  Pardiso *used_ = nullptr;
  bool supernodes_ = false;
  std::vector<int64_t> start_, column_;
  std::vector<double> value_;
  mutable std::vector<double> given_, found_;
};

}  // namespace thinshell
