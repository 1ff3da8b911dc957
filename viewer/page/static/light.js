// Day, night, or as the device says. Remembered on this device alone.
const NAMES = { auto: "auto", day: "day", night: "night" };
const NEXT = { auto: "day", day: "night", night: "auto" };

function remembered() {
  try {
    return localStorage.getItem("light") ?? "auto";
  } catch {
    return "auto"; // storage is switched off
  }
}

export function light(button) {
  let mode = remembered() in NAMES ? remembered() : "auto";
  const apply = () => {
    document.documentElement.dataset.light = mode;
    button.textContent = `Light: ${NAMES[mode]}`;
  };
  button.addEventListener("click", () => {
    mode = NEXT[mode];
    try {
      localStorage.setItem("light", mode);
    } catch {
      // kept until the page is closed
    }
    apply();
  });
  apply();
}
