/* The gated recurrent unit with a fed back state of recurrence.py, forwards and backwards.

   A trajectory of the batch depends on no other, so a block of ROWS of them goes through the whole
   horizon at once: its state and the weights then stay in the nearest caches, and what is left is
   matrix products of a few rows (`product`), with the pointwise part applied before their result
   has left. The weights' gradients are sums over steps and rows, and are left to the caller.

   Arrays are row by row, float32. Leading axis M: independent networks, each with its own weights.
   A row adds its products in the same order whatever the batch, so a forecast does not depend on
   what else is forecast beside it. */

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

/* Blocks first … last - 1 of the M · ceil(B / ROWS) there are.

   inputs [M, B, T, C], drift [M, B, T, D], hidden [M, B, H], state [M, B, D],
   enter [M, C + D, 3H] (of the inputs, then of the state), weight [M, H, 3H],
   bias [M, 2, 3H] (of the inputs, of the hidden state), out [M, H, D]. Noise, where not null:
   noise [M, B, T, D] and spread [M, H + 1, D] (of the hidden state, then the bias).

   Writes states [M, B, T + 1, D] and, where not null, hiddens [M, B, T + 1, H] and what the
   derivative needs besides: seen [M, B, T + 1, C + D + 1], that is the inputs, the state and a 1, and gates
   [M, B, T, 4H], that is r, u, n and g_n. (Step T of `seen` is left at zero.) */
void forward(
    long first, long last, long batch, long steps, long C, long D, long H, float keep,
    const float *inputs, const float *drift, const float *hidden, const float *state,
    const float *enter, const float *weight, const float *bias, const float *out,
    const float *spread, const float *noise, float *hiddens, float *states, float *seen,
    float *gates)
{
    const long blocks = (batch + ROWS - 1) / ROWS, X = C + D, HH = padded(H), DD = padded(D);
    const long both = padded(2 * H), width = both + 2 * HH;
    float *enter_both = zeros(X * both), *enter_n = zeros(X * HH);
    float *weight_both = zeros(H * both), *weight_n = zeros(H * HH), *out_packed = zeros(H * DD);
    float *spread_packed = zeros(H * DD), *w = zeros(ROWS * DD);
    float *start = zeros(width), *g = zeros(ROWS * width), *h = zeros(ROWS * HH);
    float *x = zeros(ROWS * (X + 1)), *s = zeros(ROWS * DD);
    long packed = -1;
    for (long index = first; index < last; index++) {
        const long m = index / blocks, row = index % blocks * ROWS;
        const long rows = batch - row < ROWS ? batch - row : ROWS;
        if (m != packed) {
            const float *in = enter + m * X * 3 * H, *re = weight + m * H * 3 * H;
            const float *b = bias + m * 6 * H;
            pack(in, X, 2 * H, 3 * H, 1, enter_both);
            pack(in + 2 * H, X, H, 3 * H, 1, enter_n);
            pack(re, H, 2 * H, 3 * H, 1, weight_both);
            pack(re + 2 * H, H, H, 3 * H, 1, weight_n);
            pack(out + m * H * D, H, D, D, 1, out_packed);
            if (noise) pack(spread + m * (H + 1) * D, H, D, D, 1, spread_packed);
            for (long j = 0; j < 2 * H; j++) start[j] = b[j] + b[3 * H + j];
            memcpy(start + both, b + 2 * H, H * sizeof(float));
            memcpy(start + both + HH, b + 5 * H, H * sizeof(float));
            packed = m;
        }
        for (long i = 0; i < rows; i++) {
            const long r = m * batch + row + i;
            memcpy(h + i * HH, hidden + r * H, H * sizeof(float));
            memcpy(s + i * DD, state + r * D, D * sizeof(float));
            if (hiddens)
                memcpy(hiddens + r * (steps + 1) * H, hidden + r * H, H * sizeof(float));
            memcpy(states + r * (steps + 1) * D, state + r * D, D * sizeof(float));
            if (seen)
                memset(seen + (r * (steps + 1) + steps) * (X + 1), 0, (X + 1) * sizeof(float));
        }
        for (long t = 0; t < steps; t++) {
            for (long i = 0; i < rows; i++) {
                const long r = m * batch + row + i;
                float *own = x + i * (X + 1);
                memcpy(own, inputs + (r * steps + t) * C, C * sizeof(float));
                memcpy(own + C, s + i * DD, D * sizeof(float));
                own[X] = 1;
                memcpy(g + i * width, start, width * sizeof(float));
                if (seen)
                    memcpy(seen + (r * (steps + 1) + t) * (X + 1), own, (X + 1) * sizeof(float));
            }
            product(rows, X, both, x, X + 1, enter_both, g, width);
            product(rows, H, both, h, HH, weight_both, g, width);
            product(rows, X, HH, x, X + 1, enter_n, g + both, width);
            product(rows, H, HH, h, HH, weight_n, g + both + HH, width);
            for (long i = 0; i < rows; i++) {
                const long r = m * batch + row + i;
                float *own = g + i * width, *mine = h + i * HH;
                for (long j = 0; j < 2 * H; j += LANES)
                    *(vec *)(own + j) = sigmoid(*(vec *)(own + j));
                for (long j = 0; j < H; j += LANES) {
                    const vec reset = *(vec *)(own + j), update = *(vec *)(own + H + j);
                    vec *n = (vec *)(own + both + j), *old = (vec *)(mine + j);
                    *n = hyperbolic_tangent(*n + reset * *(vec *)(own + both + HH + j));
                    *old = *n + update * (*old - *n);
                }
                if (hiddens)
                    memcpy(hiddens + (r * (steps + 1) + t + 1) * H, mine, H * sizeof(float));
                if (gates) {
                    float *kept = gates + (r * steps + t) * 4 * H;
                    memcpy(kept, own, 2 * H * sizeof(float));
                    memcpy(kept + 2 * H, own + both, H * sizeof(float));
                    memcpy(kept + 3 * H, own + both + HH, H * sizeof(float));
                }
                float *next = s + i * DD;
                const float *add = drift + (r * steps + t) * D;
                for (long j = 0; j < D; j++) next[j] = keep * next[j] + add[j];
            }
            product(rows, H, DD, h, HH, out_packed, s, DD);
            if (noise) {
                const float *offset = spread + (m * (H + 1) + H) * D;
                for (long i = 0; i < rows; i++) memcpy(w + i * DD, offset, D * sizeof(float));
                product(rows, H, DD, h, HH, spread_packed, w, DD);
            }
            for (long i = 0; noise && i < rows; i++) {
                const float *own = noise + ((m * batch + row + i) * steps + t) * D;
                for (long j = 0; j < DD; j += LANES) {
                    vec *factor = (vec *)(w + i * DD + j);
                    *factor = exponential(hyperbolic_tangent(*factor));
                }
                for (long j = 0; j < D; j++) s[i * DD + j] += w[i * DD + j] * own[j];
            }
            for (long i = 0; i < rows; i++) {
                const long r = m * batch + row + i;
                memcpy(states + (r * (steps + 1) + t + 1) * D, s + i * DD, D * sizeof(float));
            }
        }
    }
    float *all[] = {enter_both, enter_n, weight_both, weight_n, out_packed, spread_packed,
                    start, g, h, x, s, w};
    for (unsigned i = 0; i < sizeof all / sizeof *all; i++) free(all[i]);
}

static void add(long count, const float *restrict from, float *restrict to)
{
    for (long j = 0; j < count; j++) to[j] += from[j];
}

/* From the derivative by h_{t+1} those by the four sums, and its share that goes to h_t directly. */
static void chain(
    long H, const float *restrict gates, const float *restrict before, float *restrict of_hidden,
    float *restrict sums)
{
    for (long j = 0; j < H; j++) {
        const float reset = gates[j], update = gates[H + j], n = gates[2 * H + j];
        const float of_n = of_hidden[j] * (1 - update) * (1 - n * n);
        sums[j] = of_n * reset;
        sums[H + j] = of_n * gates[3 * H + j] * reset * (1 - reset);
        sums[2 * H + j] = of_hidden[j] * (before[j] - n) * update * (1 - update);
        sums[3 * H + j] = of_n;
        of_hidden[j] *= update;
    }
}

/* The chain rule, from the last step to the first; sizes and blocks as above.

   of_hiddens [M, B, T, H] and of_states [M, B, T, D] (either may be null) are the loss's
   derivatives by the results. Writes those by the gates' sums, sums [M, B, T + 1, 4H]: g_n, r, u,
   x_n; and of drift [M, B, T + 1, D], of_hidden [M, B, H], of_state [M, B, D]. (Step T of the two
   is zero, so that step t stands beside step t of `hiddens` and `seen`.) */
void backward(
    long first, long last, long batch, long steps, long C, long D, long H, float keep,
    const float *enter, const float *weight, const float *out, const float *hiddens,
    const float *gates, const float *of_hiddens, const float *of_states, float *sums,
    float *of_drift, float *of_hidden, float *of_state)
{
    const long blocks = (batch + ROWS - 1) / ROWS, HH = padded(H), DD = padded(D);
    float *back = zeros(3 * H * HH), *feed_back = zeros(3 * H * DD), *out_back = zeros(D * HH);
    float *weight_t = zeros(3 * H * H), *d = zeros(ROWS * 4 * H);
    float *dh = zeros(ROWS * HH), *ds = zeros(ROWS * DD);
    long packed = -1;
    for (long index = first; index < last; index++) {
        const long m = index / blocks, row = index % blocks * ROWS;
        const long rows = batch - row < ROWS ? batch - row : ROWS;
        if (m != packed) {
            /* Of the products' transposes: rows in the order g_n, r, u as in `sums`. */
            const float *re = weight + m * H * 3 * H;
            for (long k = 0; k < 3 * H; k++)
                for (long j = 0; j < H; j++)
                    weight_t[k * H + j] = re[j * 3 * H + (k + 2 * H) % (3 * H)];
            pack(weight_t, 3 * H, H, H, 1, back);
            pack(enter + (m * (C + D) + C) * 3 * H, 3 * H, D, 1, 3 * H, feed_back);
            pack(out + m * H * D, D, H, 1, D, out_back);
            packed = m;
        }
        memset(dh, 0, ROWS * HH * sizeof(float));
        memset(ds, 0, ROWS * DD * sizeof(float));
        for (long i = 0; i < rows; i++) {
            const long end = (m * batch + row + i) * (steps + 1) + steps;
            memset(sums + end * 4 * H, 0, 4 * H * sizeof(float));
            memset(of_drift + end * D, 0, D * sizeof(float));
        }
        for (long t = steps - 1; t >= 0; t--) {
            for (long i = 0; i < rows; i++) {
                const long r = m * batch + row + i;
                if (of_hiddens) add(H, of_hiddens + (r * steps + t) * H, dh + i * HH);
                if (of_states) add(D, of_states + (r * steps + t) * D, ds + i * DD);
                memcpy(of_drift + (r * (steps + 1) + t) * D, ds + i * DD, D * sizeof(float));
            }
            if (D) product(rows, D, HH, ds, DD, out_back, dh, HH);
            for (long i = 0; i < rows; i++) {
                const long r = m * batch + row + i;
                const float *before = hiddens + (r * (steps + 1) + t) * H;
                float *own = d + i * 4 * H;
                chain(H, gates + (r * steps + t) * 4 * H, before, dh + i * HH, own);
                memcpy(sums + (r * (steps + 1) + t) * 4 * H, own, 4 * H * sizeof(float));
                for (long j = 0; j < D; j++) ds[i * DD + j] *= keep;
            }
            product(rows, 3 * H, HH, d, 4 * H, back, dh, HH);
            if (D) product(rows, 3 * H, DD, d + H, 4 * H, feed_back, ds, DD);
        }
        for (long i = 0; i < rows; i++) {
            const long r = m * batch + row + i;
            memcpy(of_hidden + r * H, dh + i * HH, H * sizeof(float));
            memcpy(of_state + r * D, ds + i * DD, D * sizeof(float));
        }
    }
    float *all[] = {back, feed_back, out_back, weight_t, d, dh, ds};
    for (unsigned i = 0; i < sizeof all / sizeof *all; i++) free(all[i]);
}
