"use strict";
const cards = [...document.querySelectorAll(".card")];
const filter = document.getElementById("filter");
const blinkTime = 600; // [ms] each picture; slower than what can harm those who flashes harm
const blinking = new Map();

const shownCards = () => cards.filter((card) => !card.hidden);

function applyFilter() {
  const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
  const show = document.querySelector("input[name=show]:checked").value;
  for (const card of cards) {
    const text = card.textContent.toLowerCase();
    const right = show === "all" || card.classList.contains(show);
    card.hidden = !(right && words.every((word) => text.includes(word)));
    if (card.hidden) setView(card, "slider");
  }
  document.getElementById("count").textContent = `${shownCards().length} of ${cards.length} frames shown`;
}

function setView(card, view) {
  const stage = card.querySelector(".stage");
  if (!stage) return;
  clearInterval(blinking.get(card));
  blinking.delete(card);
  stage.dataset.view = view;
  delete stage.dataset.now;
  for (const button of card.querySelectorAll(".views button")) {
    button.setAttribute("aria-pressed", String(button.dataset.view === view));
  }
  const label = card.querySelector(".shown");
  label.textContent = "";
  if (view !== "blink") return;
  const swap = () => {
    stage.dataset.now = stage.dataset.now === "reference" ? "new" : "reference";
    label.textContent = stage.dataset.now;
  };
  swap();
  blinking.set(card, setInterval(swap, blinkTime));
}

function slide(card) {
  const range = card.querySelector(".slide input");
  card.querySelector(".stage").style.setProperty("--cut", `${range.value}%`);
}

function prepare(card) {
  const copy = card.querySelector(".copy");
  const command = card.querySelector(".update code");
  copy.hidden = false;
  copy.addEventListener("click", async () => {
    getSelection().selectAllChildren(command);
    try {
      await navigator.clipboard.writeText(command.textContent);
      copy.textContent = "Copied";
    } catch {
      copy.textContent = "Selected";
    }
  });
  const stage = card.querySelector(".stage");
  if (!stage) return;
  for (const [kind, place] of [["new", ".under"], ["reference", ".over"]]) {
    stage.querySelector(place).src = card.querySelector(`figure[data-kind=${kind}] img`).src;
  }
  card.querySelector(".compare").hidden = false;
  card.querySelector(".slide input").addEventListener("input", () => { setView(card, "slider"); slide(card); });
  for (const button of card.querySelectorAll(".views button")) {
    button.addEventListener("click", () => setView(card, button.dataset.view));
  }
}

function go(step) {
  const shown = shownCards();
  if (!shown.length) return;
  const here = shown.indexOf(document.activeElement.closest(".card"));
  const next = here < 0 ? 0 : Math.min(shown.length - 1, Math.max(0, here + step));
  shown[next].focus();
  shown[next].scrollIntoView({ block: "start" });
}

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target === filter) {
    if (event.key === "Escape") filter.blur();
    return;
  }
  const card = document.activeElement.closest(".card") ?? shownCards()[0];
  if (event.key === "/") filter.focus();
  else if (event.key === "j") go(1);
  else if (event.key === "k") go(-1);
  else if (event.key === "b" && card) setView(card, blinking.has(card) ? "slider" : "blink");
  else if (event.key === "s" && card) {
    setView(card, "slider");
    card.querySelector(".slide input")?.focus();
  } else if (["ArrowLeft", "ArrowRight"].includes(event.key) && event.target === card && card.querySelector(".stage")) {
    const range = card.querySelector(".slide input");
    range.value = Number(range.value) + (event.key === "ArrowLeft" ? -5 : 5);
    setView(card, "slider");
    slide(card);
  } else return;
  event.preventDefault();
});

cards.forEach(prepare);
filter.addEventListener("input", applyFilter);
document.getElementById("words").addEventListener("change", applyFilter);
document.querySelector(".tools").hidden = false;
applyFilter();
