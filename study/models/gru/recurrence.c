/* The gated recurrent unit with a fed back state of recurrence.py, forwards and backwards.

   The trajectories of a batch are independent. So a block of ROWS trajectories runs through the
   whole horizon at once, and its state and the weights stay in the nearest caches. Each step is a
   few matrix products of a few rows (`product`). The pointwise operations follow while the result
   is still in the cache. The gradients of the weights are sums over steps and rows; the caller
   computes them.

   Arrays are float32 in row-major order. The leading axis M is that of independent networks, each
   with its own weights. A row adds its products in the same order for every batch size, so a
   forecast does not depend on the other forecasts of the batch. */

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef __AVX512F__
#define LANES 16
#else
#define LANES 8
#endif
#define WIDE (2 * LANES) /* columns of a tile: two vectors */
#define TALL 6           /* rows of a tile: with WIDE columns, twelve registers of sums */
#define ROWS 12          /* rows that go through the horizon together */

typedef float vec __attribute__((vector_size(4 * LANES), aligned(4), may_alias));
typedef int32_t ivec __attribute__((vector_size(4 * LANES), aligned(4), may_alias));

static inline long padded(long columns) { return (columns + WIDE - 1) / WIDE * WIDE; }

static inline vec choose(ivec where, vec yes, vec no)
{
    return (vec)((where & (ivec)yes) | (~where & (ivec)no));
}

/* exp by 2^k times a polynomial on [-ln 2 / 2, ln 2 / 2]: relative error about 1e-7. */
static inline vec exponential(vec x)
{
    const vec zero = {0};
    x = choose(x > 88.0f, zero + 88.0f, choose(x < -87.0f, zero - 87.0f, x));
    const vec shifted = x * 1.44269504f + 12582912.0f; /* rounds to an integer k */
    const vec k = shifted - 12582912.0f;
    const vec f = (x - k * 0.693359375f) + k * 2.12194440e-4f;
    vec p = zero + 1.9875691500e-4f;
    p = p * f + 1.3981999507e-3f;
    p = p * f + 8.3334519073e-3f;
    p = p * f + 4.1665795894e-2f;
    p = p * f + 1.6666665459e-1f;
    p = p * f + 5.0000001201e-1f;
    p = p * (f * f) + f + 1.0f;
    const ivec scale = ((ivec)shifted << 23) + 0x3f800000;
    return p * (vec)scale;
}

static inline vec sigmoid(vec x) { return 1.0f / (1.0f + exponential(-x)); }
static inline vec hyperbolic_tangent(vec x) { return 1.0f - 2.0f / (1.0f + exponential(2.0f * x)); }

/* right [depth, columns] in strips of WIDE columns, each strip's rows one after the other. */
static void pack(const float *right, long depth, long columns, long row, long column, float *packed)
{
    for (long strip = 0; strip < padded(columns); strip += WIDE)
        for (long k = 0; k < depth; k++)
            for (long j = strip; j < strip + WIDE; j++)
                *packed++ = j < columns ? right[k * row + j * column] : 0.0f;
}

static inline __attribute__((always_inline)) void tile(
    const int rows, long depth, const float *left, long left_row, const float *packed, float *sums,
    long sums_row)
{
    vec a[TALL], b[TALL];
    for (int i = 0; i < rows; i++) {
        a[i] = *(const vec *)(sums + i * sums_row);
        b[i] = *(const vec *)(sums + i * sums_row + LANES);
    }
    for (long k = 0; k < depth; k++) {
        const vec first = *(const vec *)(packed + k * WIDE);
        const vec second = *(const vec *)(packed + k * WIDE + LANES);
        for (int i = 0; i < rows; i++) {
            const float factor = left[i * left_row + k];
            a[i] += factor * first;
            b[i] += factor * second;
        }
    }
    for (int i = 0; i < rows; i++) {
        *(vec *)(sums + i * sums_row) = a[i];
        *(vec *)(sums + i * sums_row + LANES) = b[i];
    }
}

/* sums [rows, columns] += left [rows, depth] · right, which is packed. */
static void product(
    long rows, long depth, long columns, const float *left, long left_row, const float *packed,
    float *sums, long sums_row)
{
    for (long strip = 0; strip < columns; strip += WIDE, packed += depth * WIDE) {
        long i = 0;
        for (; i + TALL <= rows; i += TALL)
            tile(TALL, depth, left + i * left_row, left_row, packed, sums + i * sums_row + strip,
                 sums_row);
        const float *rest = left + i * left_row;
        float *into = sums + i * sums_row + strip;
        switch (rows - i) {
        case 5: tile(5, depth, rest, left_row, packed, into, sums_row); break;
        case 4: tile(4, depth, rest, left_row, packed, into, sums_row); break;
        case 3: tile(3, depth, rest, left_row, packed, into, sums_row); break;
        case 2: tile(2, depth, rest, left_row, packed, into, sums_row); break;
        case 1: tile(1, depth, rest, left_row, packed, into, sums_row); break;
        }
    }
}

static float *zeros(long count)
{
    float *memory = calloc(count + WIDE, sizeof(float));
    if (!memory) abort();
    return memory;
}

/* The forward pass of the blocks first … last - 1. There are M · ceil(B / ROWS) blocks.

   Reads inputs [M, B, T, C], offset [M, B, T, D], hidden [M, B, H], state [M, B, D],
   weight_ih [M, C + D, 3H] (rows of the inputs, then of the state), weight_hh [M, H, 3H],
   bias [M, 2, 3H] (of the inputs, then of the hidden state) and weight_ho [M, H, D].
   With noise also noise [M, B, T, D] and log_std_weight [M, H + 1, D] (rows of the hidden state,
   then the bias); without noise both are null.

   Writes states [M, B, T + 1, D]. Writes hiddens [M, B, T + 1, H] unless null, and what the
   backward pass needs unless null: gates [M, B, T, 4H], which are r, u, n and g_n, and gate_inputs
   [M, B, T + 1, C + D + 1], which are the inputs, the state and a 1. Step T of `gate_inputs` is
   zero. */
void forward(
    long first, long last, long batch, long steps, long C, long D, long H, float residual,
    const float *inputs, const float *offset, const float *hidden, const float *state,
    const float *weight_ih, const float *weight_hh, const float *bias, const float *weight_ho,
    const float *log_std_weight, const float *noise, float *hiddens, float *states,
    float *gate_inputs, float *gates)
{
    const long blocks = (batch + ROWS - 1) / ROWS, X = C + D, HH = padded(H), DD = padded(D);
    const long RU = padded(2 * H), row_size = RU + 2 * HH;
    float *ih_ru = zeros(X * RU), *ih_n = zeros(X * HH);
    float *hh_ru = zeros(H * RU), *hh_n = zeros(H * HH), *ho_packed = zeros(H * DD);
    float *log_std_packed = zeros(H * DD), *w = zeros(ROWS * DD);
    float *start = zeros(row_size), *g = zeros(ROWS * row_size), *h = zeros(ROWS * HH);
    float *x = zeros(ROWS * (X + 1)), *s = zeros(ROWS * DD);
    long packed = -1;
    for (long index = first; index < last; index++) {
        const long m = index / blocks, row = index % blocks * ROWS;
        const long rows = batch - row < ROWS ? batch - row : ROWS;
        if (m != packed) {
            const float *ih = weight_ih + m * X * 3 * H, *hh = weight_hh + m * H * 3 * H;
            const float *b = bias + m * 6 * H;
            pack(ih, X, 2 * H, 3 * H, 1, ih_ru);
            pack(ih + 2 * H, X, H, 3 * H, 1, ih_n);
            pack(hh, H, 2 * H, 3 * H, 1, hh_ru);
            pack(hh + 2 * H, H, H, 3 * H, 1, hh_n);
            pack(weight_ho + m * H * D, H, D, D, 1, ho_packed);
            if (noise) pack(log_std_weight + m * (H + 1) * D, H, D, D, 1, log_std_packed);
            for (long j = 0; j < 2 * H; j++) start[j] = b[j] + b[3 * H + j];
            memcpy(start + RU, b + 2 * H, H * sizeof(float));
            memcpy(start + RU + HH, b + 5 * H, H * sizeof(float));
            packed = m;
        }
        for (long i = 0; i < rows; i++) {
            const long r = m * batch + row + i;
            memcpy(h + i * HH, hidden + r * H, H * sizeof(float));
            memcpy(s + i * DD, state + r * D, D * sizeof(float));
            if (hiddens)
                memcpy(hiddens + r * (steps + 1) * H, hidden + r * H, H * sizeof(float));
            memcpy(states + r * (steps + 1) * D, state + r * D, D * sizeof(float));
            if (gate_inputs)
                memset(gate_inputs + (r * (steps + 1) + steps) * (X + 1), 0,
                       (X + 1) * sizeof(float));
        }
        for (long t = 0; t < steps; t++) {
            for (long i = 0; i < rows; i++) {
                const long r = m * batch + row + i;
                float *row_x = x + i * (X + 1);
                memcpy(row_x, inputs + (r * steps + t) * C, C * sizeof(float));
                memcpy(row_x + C, s + i * DD, D * sizeof(float));
                row_x[X] = 1;
                memcpy(g + i * row_size, start, row_size * sizeof(float));
                if (gate_inputs)
                    memcpy(gate_inputs + (r * (steps + 1) + t) * (X + 1), row_x,
                           (X + 1) * sizeof(float));
            }
            product(rows, X, RU, x, X + 1, ih_ru, g, row_size);
            product(rows, H, RU, h, HH, hh_ru, g, row_size);
            product(rows, X, HH, x, X + 1, ih_n, g + RU, row_size);
            product(rows, H, HH, h, HH, hh_n, g + RU + HH, row_size);
            for (long i = 0; i < rows; i++) {
                const long r = m * batch + row + i;
                float *row_g = g + i * row_size, *row_h = h + i * HH;
                for (long j = 0; j < 2 * H; j += LANES)
                    *(vec *)(row_g + j) = sigmoid(*(vec *)(row_g + j));
                for (long j = 0; j < H; j += LANES) {
                    const vec reset = *(vec *)(row_g + j), update = *(vec *)(row_g + H + j);
                    vec *n = (vec *)(row_g + RU + j), *old = (vec *)(row_h + j);
                    *n = hyperbolic_tangent(*n + reset * *(vec *)(row_g + RU + HH + j));
                    *old = *n + update * (*old - *n);
                }
                if (hiddens)
                    memcpy(hiddens + (r * (steps + 1) + t + 1) * H, row_h, H * sizeof(float));
                if (gates) {
                    float *row_gates = gates + (r * steps + t) * 4 * H;
                    memcpy(row_gates, row_g, 2 * H * sizeof(float));
                    memcpy(row_gates + 2 * H, row_g + RU, H * sizeof(float));
                    memcpy(row_gates + 3 * H, row_g + RU + HH, H * sizeof(float));
                }
                float *next = s + i * DD;
                const float *step_offset = offset + (r * steps + t) * D;
                for (long j = 0; j < D; j++) next[j] = residual * next[j] + step_offset[j];
            }
            product(rows, H, DD, h, HH, ho_packed, s, DD);
            if (noise) {
                const float *log_std_bias = log_std_weight + (m * (H + 1) + H) * D;
                for (long i = 0; i < rows; i++) memcpy(w + i * DD, log_std_bias, D * sizeof(float));
                product(rows, H, DD, h, HH, log_std_packed, w, DD);
            }
            for (long i = 0; noise && i < rows; i++) {
                const float *row_noise = noise + ((m * batch + row + i) * steps + t) * D;
                for (long j = 0; j < DD; j += LANES) {
                    vec *factor = (vec *)(w + i * DD + j);
                    *factor = exponential(hyperbolic_tangent(*factor));
                }
                for (long j = 0; j < D; j++) s[i * DD + j] += w[i * DD + j] * row_noise[j];
            }
            for (long i = 0; i < rows; i++) {
                const long r = m * batch + row + i;
                memcpy(states + (r * (steps + 1) + t + 1) * D, s + i * DD, D * sizeof(float));
            }
        }
    }
    float *all[] = {ih_ru, ih_n, hh_ru, hh_n, ho_packed, log_std_packed, start, g, h, x, s, w};
    for (unsigned i = 0; i < sizeof all / sizeof *all; i++) free(all[i]);
}

static void add(long count, const float *restrict from, float *restrict to)
{
    for (long j = 0; j < count; j++) to[j] += from[j];
}

/* The chain rule through the gates. `grad_hidden` holds the gradient of h_{t+1}. The function writes
   the gradients of the four sums g_n, r, u and x_n. It then replaces `grad_hidden` by u times its
   value, the direct part of the gradient of h_t. */
static void chain(
    long H, const float *restrict gates, const float *restrict before, float *restrict grad_hidden,
    float *restrict sums)
{
    for (long j = 0; j < H; j++) {
        const float reset = gates[j], update = gates[H + j], n = gates[2 * H + j];
        const float grad_n = grad_hidden[j] * (1 - update) * (1 - n * n);
        sums[j] = grad_n * reset;
        sums[H + j] = grad_n * gates[3 * H + j] * reset * (1 - reset);
        sums[2 * H + j] = grad_hidden[j] * (before[j] - n) * update * (1 - update);
        sums[3 * H + j] = grad_n;
        grad_hidden[j] *= update;
    }
}

/* The backward pass, from the last step to the first. Sizes and blocks are those of `forward`.

   Reads the gradients of the results, grad_hiddens [M, B, T, H] and grad_states [M, B, T, D];
   either may be null. Writes those of the gates' sums, sums [M, B, T + 1, 4H] in the order g_n, r,
   u, x_n, and grad_offset [M, B, T + 1, D], grad_hidden [M, B, H] and grad_state [M, B, D]. Step T
   of sums and grad_offset is zero, so that their steps align with those of `hiddens` and
   `gate_inputs`. */
void backward(
    long first, long last, long batch, long steps, long C, long D, long H, float residual,
    const float *weight_ih, const float *weight_hh, const float *weight_ho, const float *hiddens,
    const float *gates, const float *grad_hiddens, const float *grad_states, float *sums,
    float *grad_offset, float *grad_hidden, float *grad_state)
{
    const long blocks = (batch + ROWS - 1) / ROWS, HH = padded(H), DD = padded(D);
    float *hh_back = zeros(3 * H * HH), *ih_back = zeros(3 * H * DD), *ho_back = zeros(D * HH);
    float *hh_transposed = zeros(3 * H * H), *d = zeros(ROWS * 4 * H);
    float *grad_h = zeros(ROWS * HH), *grad_s = zeros(ROWS * DD);
    long packed = -1;
    for (long index = first; index < last; index++) {
        const long m = index / blocks, row = index % blocks * ROWS;
        const long rows = batch - row < ROWS ? batch - row : ROWS;
        if (m != packed) {
            /* Transposes of the weights; rows in the order g_n, r, u of `sums`. */
            const float *hh = weight_hh + m * H * 3 * H;
            for (long k = 0; k < 3 * H; k++)
                for (long j = 0; j < H; j++)
                    hh_transposed[k * H + j] = hh[j * 3 * H + (k + 2 * H) % (3 * H)];
            pack(hh_transposed, 3 * H, H, H, 1, hh_back);
            pack(weight_ih + (m * (C + D) + C) * 3 * H, 3 * H, D, 1, 3 * H, ih_back);
            pack(weight_ho + m * H * D, D, H, 1, D, ho_back);
            packed = m;
        }
        memset(grad_h, 0, ROWS * HH * sizeof(float));
        memset(grad_s, 0, ROWS * DD * sizeof(float));
        for (long i = 0; i < rows; i++) {
            const long end = (m * batch + row + i) * (steps + 1) + steps;
            memset(sums + end * 4 * H, 0, 4 * H * sizeof(float));
            memset(grad_offset + end * D, 0, D * sizeof(float));
        }
        for (long t = steps - 1; t >= 0; t--) {
            for (long i = 0; i < rows; i++) {
                const long r = m * batch + row + i;
                if (grad_hiddens) add(H, grad_hiddens + (r * steps + t) * H, grad_h + i * HH);
                if (grad_states) add(D, grad_states + (r * steps + t) * D, grad_s + i * DD);
                memcpy(grad_offset + (r * (steps + 1) + t) * D, grad_s + i * DD, D * sizeof(float));
            }
            if (D) product(rows, D, HH, grad_s, DD, ho_back, grad_h, HH);
            for (long i = 0; i < rows; i++) {
                const long r = m * batch + row + i;
                const float *before = hiddens + (r * (steps + 1) + t) * H;
                float *row_d = d + i * 4 * H;
                chain(H, gates + (r * steps + t) * 4 * H, before, grad_h + i * HH, row_d);
                memcpy(sums + (r * (steps + 1) + t) * 4 * H, row_d, 4 * H * sizeof(float));
                for (long j = 0; j < D; j++) grad_s[i * DD + j] *= residual;
            }
            product(rows, 3 * H, HH, d, 4 * H, hh_back, grad_h, HH);
            if (D) product(rows, 3 * H, DD, d + H, 4 * H, ih_back, grad_s, DD);
        }
        for (long i = 0; i < rows; i++) {
            const long r = m * batch + row + i;
            memcpy(grad_hidden + r * H, grad_h + i * HH, H * sizeof(float));
            memcpy(grad_state + r * D, grad_s + i * DD, D * sizeof(float));
        }
    }
    float *all[] = {hh_back, ih_back, ho_back, hh_transposed, d, grad_h, grad_s};
    for (unsigned i = 0; i < sizeof all / sizeof *all; i++) free(all[i]);
}
