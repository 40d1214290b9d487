/* The operations on one row: features of a state, and the gates of the memory. */

#define SMALLEST_DISTANCE 1e-3f /* in SI units; it keeps the direction of the axis finite */

/* cos φ, sin φ and 1/r of the axis from one point of a state to another, at the distance r. */
static void axis(const Weights *weights, const float *state, float *frame)
{
    const int64_t *from = weights->axis_columns, *to = from + 2;
    const float a = weights->axis_scale[0], b = weights->axis_scale[1];
    const float x = b * state[to[0]] - a * state[from[0]];
    const float y = b * state[to[1]] - a * state[from[1]];
    const float distance = sqrtf(x * x + y * y);
    frame[2] = 1.0f / (distance > SMALLEST_DISTANCE ? distance : SMALLEST_DISTANCE);
    frame[0] = x * frame[2];
    frame[1] = y * frame[2];
}

/* Turn the pairs of `values` [D] by φ (sign 1) or −φ (sign −1). */
static void turn(
    const Layout *n, const Weights *weights, const float *frame, float sign, float *values)
{
    const float c = frame[0], s = sign * frame[1];
    for (long k = 0; k < n->Q; k++) {
        float *x = values + weights->pair_columns[2 * k];
        float *y = values + weights->pair_columns[2 * k + 1];
        const float first = *x, second = *y;
        *x = c * first - s * second;
        *y = s * first + c * second;
    }
}

/* Σ (x v − y u) over the pairs (x, y) of `values` and (u, v) of `gradient`: the gradient with
   respect to φ, where φ turns `values`. */
static float by_angle(
    const Layout *n, const Weights *weights, const float *values, const float *gradient)
{
    float sum = 0;
    for (long k = 0; k < n->Q; k++) {
        const long i = weights->pair_columns[2 * k], j = weights->pair_columns[2 * k + 1];
        sum += values[i] * gradient[j] - values[j] * gradient[i];
    }
    return sum;
}

/* Add the gradient of the axis, d/dφ, to that of the state. It holds for distances of at least
   SMALLEST_DISTANCE. */
static void through_axis(const Weights *weights, const float *frame, float by_phi, float *grad_s)
{
    const int64_t *from = weights->axis_columns, *to = from + 2;
    const float a = weights->axis_scale[0], b = weights->axis_scale[1];
    const float by_x = -frame[1] * frame[2] * by_phi, by_y = frame[0] * frame[2] * by_phi;
    grad_s[to[0]] += b * by_x;
    grad_s[to[1]] += b * by_y;
    grad_s[from[0]] -= a * by_x;
    grad_s[from[1]] -= a * by_y;
}

/* f = [s, sin ψ, cos ψ, sin 2ψ, cos 2ψ] for the angles ψ of a state, s in the canonical frame. */
static void features(
    const Layout *n, const Weights *weights, const float *state, const float *frame, float *f)
{
    copy(n->D, state, f);
    if (n->Q) turn(n, weights, frame, -1, f);
    for (long k = 0; k < n->K; k++) {
        const float angle =
            state[weights->angle_columns[k]] * weights->angle_scale[k] + weights->angle_mean[k];
        const float s = sinf(angle), c = cosf(angle);
        float *values = f + n->D + k;
        values[0] = s;
        values[n->K] = c;
        values[2 * n->K] = 2 * s * c;
        values[3 * n->K] = c * c - s * s;
    }
}

/* h_{t+1} from the sums x_n, r, u and g_n of a row, which `gates` replaces by r, u, n and g_n. */
static void advance(long H, const float *sums, float *gates, long stride, float *h)
{
    for (long j = 0; j < H; j += LANES) {
        const vec r = sigmoid(load(sums + H + j)), u = sigmoid(load(sums + 2 * H + j));
        const vec g = load(sums + 3 * H + j);
        const vec n = hyperbolic_tangent(load(sums + j) + r * g);
        store(r, gates + j);
        store(u, gates + stride + j);
        store(n, gates + 2 * stride + j);
        store(g, gates + 3 * stride + j);
        store(n + u * (load(h + j) - n), h + j);
    }
}

/* The chain rule through the gates. `grad_h` holds the gradient of h_{t+1}. Writes the gradients of
   the sums x_n, r, u and g_n. Replaces `grad_h` by the direct part of the gradient of h_t. */
static void through_gates(
    long H, const float *restrict gates, const float *restrict before, float *restrict grad_h,
    float *restrict sums)
{
    for (long j = 0; j < H; j++) {
        const float r = gates[j], u = gates[H + j], n = gates[2 * H + j], g = gates[3 * H + j];
        const float grad_n = grad_h[j] * (1 - u) * (1 - n * n);
        sums[j] = grad_n;
        sums[H + j] = grad_n * g * r * (1 - r);
        sums[2 * H + j] = grad_h[j] * (before[j] - n) * u * (1 - u);
        sums[3 * H + j] = grad_n * r;
        grad_h[j] *= u;
    }
}

/* The gradient of a state [D] from that of its features [F]. With a canonical frame, `grad_s` holds
   the gradient of the next state, which is the state plus the turned change; see `Tape`. */
static void through_features(
    const Layout *n, const Weights *weights, float decay, const float *f, const float *frame,
    float *grad_f, float *grad_s)
{
    if (n->Q) {
        const float *change = frame + 3;
        const float by_phi =
            by_angle(n, weights, change, grad_s) - by_angle(n, weights, f, grad_f);
        turn(n, weights, frame, 1, grad_f);
        for (long j = 0; j < n->D; j++) grad_s[j] += grad_f[j];
        through_axis(weights, frame, by_phi, grad_s);
        for (long j = 0; j < n->D; j++) grad_s[j] *= decay;
    } else {
        for (long j = 0; j < n->D; j++) grad_s[j] = decay * grad_f[j];
    }
    for (long k = 0; k < n->K; k++) {
        const float *value = f + n->D + k, *grad = grad_f + n->D + k;
        const long K = n->K;
        const float slope = value[K] * grad[0] - value[0] * grad[K]
                            + 2 * (value[3 * K] * grad[2 * K] - value[2 * K] * grad[3 * K]);
        grad_s[weights->angle_columns[k]] += decay * weights->angle_scale[k] * slope;
    }
}
