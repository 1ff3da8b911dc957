// Numbers as a person reads them.
export function ago(seconds) {
  const whole = Math.max(0, Math.floor(seconds));
  if (whole < 120) return `${whole} s`;
  if (whole < 7200) return `${Math.floor(whole / 60)} min`;
  if (whole < 172800) return `${Math.floor(whole / 3600)} h`;
  return `${Math.floor(whole / 86400)} days`;
}

export function number(value, digits = 0) {
  if (value === null || value === undefined) return "–";
  // Thin spaces between thousands: neither comma nor point, which mean different things in different countries.
  const [whole, rest] = Math.abs(value).toFixed(digits).split(".");
  const grouped = whole.replace(/\B(?=(\d{3})+(?!\d))/g, "\u2009");
  return (value < 0 ? "−" : "") + grouped + (rest ? `.${rest}` : "");
}

// A load: grams in, [figure, unit] out; one unit for a figure and the interval around it.
export function loadUnit(grams) {
  return grams >= 9.9995e6 ? { unit: "t", per: 1e6, digits: 2 } : { unit: "kg", per: 1e3, digits: grams < 1e5 ? 2 : grams < 1e6 ? 1 : 0 };
}

export function load(grams, scale) {
  return number(grams / scale.per, scale.digits);
}

export function when(unixS) {
  return new Date(unixS * 1000).toLocaleString(undefined, { dateStyle: "short", timeStyle: "short" });
}
